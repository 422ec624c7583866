"""Smoothing SLAM, one frame at a time, with GTSAM doing the solving."""

import logging
from collections.abc import Collection
from contextlib import suppress
from dataclasses import replace

import gtsam
import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.estimator import Problem, shared_information
from vislam.core.frame import Frame
from vislam.core.lagged import LagReader
from vislam.core.step import Final, State, Step
from vislam.core.trajectory import Landmarks, Poses
from vislam.estimators.smoother import motion
from vislam.estimators.smoother.batch import Drive
from vislam.estimators.smoother.between import Between
from vislam.estimators.smoother.descent import Budget, Tell
from vislam.estimators.smoother.ending import relinearised
from vislam.estimators.smoother.engine import WholeGraph
from vislam.estimators.smoother.factors import StereoFactors
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.recovery import Recovery
from vislam.estimators.smoother.restart import restarted
from vislam.estimators.smoother.solver import Solver, shared_keys
from vislam.estimators.smoother.tracks import Track
from vislam.estimators.smoother.tree import IndeterminateError
from vislam.estimators.smoother.world import GraphCovariances, Origin, ReportedWorld
from vislam.models.inertial_gap import InertialState
from vislam.models.kernel import kernel_name
from vislam.models.shared_errors import FOCAL_SCALE, OF_PIXELS, SIZES

_log = logging.getLogger("vislam.estimators.smoother")
_NOWHERE = Origin(np.eye(4), np.zeros(3))


class SmootherEstimator:
    """Poses, twist biases and landmarks in one graph, of the whole sequence or of a lag.

    Only variables observed in the last frames are relinearised in between: the linearisation of what lies
    behind hardly matters for what comes, and redoing it costs the whole tree. In the end everything is, and
    after a step whose solution is farther from its prediction than one linearisation is good for.

    A step that GTSAM cannot solve is not the end. Its factors and its linearisation point are still there,
    and from these, without the landmarks that broke it, the solver is rebuilt and the step repeated. The
    solver recovery is counted and reported.

    Attributes
    ----------
    tell : callable
        Is given a line after each iteration of the optimisation in the end; by default it is logged.
    """

    def __init__(self, problem: Problem, options: SmootherOptions) -> None:
        self.tell: Tell = _log.info
        if problem.lags is not None:
            # A change that is left alone as small would be missing from the poses that are read later.
            options = replace(options, wildfire_threshold=0.0)
        if FOCAL_SCALE in problem.shared() and options.factorization == "auto":
            # Cholesky refuses the tie between both focal lengths; asking it at each step costs more.
            options = replace(options, factorization="qr")
        self._lags = None if problem.lags is None else LagReader(problem.lags)
        self._problem, self._options = problem, options
        kernel = problem.kernel if options.plain else None
        self._gaussian = options.plain and kernel is None
        self._motion = motion.make(problem, options)
        self.upright = problem.imu is not None
        self.information = {
            "noise of the tracks": _noise(options),
            "kernel": "truncated least squares" if options.final == "gnc" else kernel_name(kernel),
            **self._motion.information,
            **shared_information(problem, estimated=_estimated(problem, options)),
        }
        self._stereo = StereoFactors(problem.rig, pixels=self._motion.pixels, kernel=kernel)
        self._world = ReportedWorld(problem)
        self._solver = Solver(
            problem.rig, options, self._motion, self._stereo, world=self._world, comes_back=problem.kept > 0
        )
        self._recovery = Recovery(problem.rig, options, self._solver)
        self._frames: list[Frame] = []
        self._between = Between(problem)
        # Of a lag, velocities and biases at keyframes as they were when they left it.
        self._left: list[InertialState] = []
        self._events: list[str] = []
        self._counts = {
            "observations_used_late": 0,
            "final_iterations_undone": 0,
            "steps_relinearised_whole": 0,
            "steps_relinearised_recent": 0,
        }

    def process(self, frame: Frame) -> Step:
        """Take one frame."""
        if not frame.keyframe:
            return self._between.predict(
                frame, self._solver.engine, with_cov=self._with_cov(self._frames[-1])
            )
        frame = self._between.keyframe(frame)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in self._motion.factors(frame, self._frames[-1] if self._frames else None):
            graph.add(factor)
        solver = self._solver
        if self._options.lag_s is not None:
            # Nothing but the step to the next frame is computed from a frame again.
            self._frames.clear()
        self._frames.append(frame)
        solver.predict(frame)
        predicted = solver.poses[-1]
        self._motion.insert(values, frame, solver.poses[-1])
        sights = [(track, track.views[-1]) for track in solver.tracks.take(frame, oldest=solver.held().start)]
        for track in solver.start():
            values.insert(track.key, track.point)
            sights += [(track, view) for view in track.views]
        owners = []
        for track, view in sights:
            for factor in self._stereo.stereo(view.k, track.key, z=view.z, sigma=view.sigma):
                graph.add(factor)
                owners.append(track)
        now = list({track.id: track for track in owners}.values())
        self._counts["observations_used_late"] += len(sights) - len(now)
        self._keep_leaving(frame)
        try:
            solver.update(frame, graph, values, owners, now)
            newest = [track for track in now if track.views[-1].k == frame.k]
            settled = solver.settle(frame, predicted, newest)
            if settled is not None:
                self._counts[f"steps_relinearised_{settled}"] += 1
        except IndeterminateError as error:
            self._recovery.repeat(frame, error)
        self._recovery.go_on(frame)
        seen = [track for track in now if track.id in solver.tracks.in_view]
        solver.find_degenerate(seen)
        if self._lags is not None:
            self._lags.take(frame.k, self._read)
        states, pose_cov = self._read_newest(frame, with_cov=self._with_cov(frame))
        return Step(
            pose=solver.reported(frame.k),
            pose_cov=pose_cov,
            states=states,
            used=np.isin(frame.stereo.track, [track.id for track in seen]),
        )

    def _with_cov(self, frame: Frame) -> bool:
        """Whether covariances are asked for at a frame of the graph."""
        every = self._options.pose_cov_every
        return every > 0 and frame.k % every == 0

    def _keep_leaving(self, frame: Frame) -> None:
        """Read what the update with a frame will marginalise."""
        if self._between.any and self._options.lag_s is not None:
            held = min(self._solver.held().start, frame.k)
            self._left += [self._between.state(self._solver.engine, k) for k in range(len(self._left), held)]
        self._solver.keep_leaving(frame)

    def _read_newest(self, frame: Frame, *, with_cov: bool) -> tuple[dict[str, State], Array | None]:
        """States and, if asked for, covariance of the newest pose, which GTSAM may fail to compute."""
        engine = self._solver.engine
        if with_cov:
            try:
                states = self._motion.states(engine, frame, with_sigma=True)
                return states, self._solver.covariance(frame.k)
            except IndeterminateError:
                self._counts["covariances_failed"] = self._counts.get("covariances_failed", 0) + 1
        return self._motion.states(engine, frame, with_sigma=False), None

    def finalize(self) -> Final:
        """Return all poses and landmarks, after what the options ask for in the end."""
        options, solver = self._options, self._solver
        lagged = {} if self._lags is None else self._lags.finish(self._read)
        tracks, past = solver.tracks.landmarks, solver.tracks.past.landmarks
        pose_cov = points_cov = fit = None
        if options.lag_s is not None:
            origin = solver.origin() if self._frames else _NOWHERE
            poses = self._lagged_poses()
            points = np.array([track.point for track in tracks]).reshape(-1, 3)
            points = self._world.points(origin, np.concatenate([past[1], points]))
        else:
            drive = self._drive(tracks)
            values = self._finish(drive)
            if self._between.any:
                drive, values = self._between.whole(drive, values)
            tracks = drive.tracks
            graph_poses = drive.poses(values)
            points = np.array([values.atPoint3(track.key) for track in tracks]).reshape(-1, 3)
            rotation = self._rotations(drive, values)
            origin = Origin(graph_poses[0], rotation[0]) if len(graph_poses) else _NOWHERE
            poses = self._world.poses(origin, graph_poses, rotation)
            points = self._world.points(origin, points)
            if self._gaussian:
                fit = drive.fit(values)
            if options.marginals != "none" and len(poses):
                pose_cov, points_cov = self._covariances(drive, values, points)
        if options.lag_s is not None:
            tracks = self._between.renumbered(tracks)
        ids = np.array([track.id for track in tracks], dtype=np.int64)
        return Final(
            trajectory=Poses(poses.reshape(-1, 4, 4), pose_cov),
            map=Landmarks(np.concatenate([past[0], ids]), points, points_cov),
            counts={
                "landmarks_too_weak": solver.tracks.too_weak + len(solver.tracks.waiting),
                "landmarks_rejected": solver.tracks.rejected,
                "observations_dropped_pending": solver.tracks.views_dropped,
                **self._counts,
                "recoveries": self._recovery.recoveries,
                "steps_by_qr": self._recovery.by_qr,
                "cholesky_failures": self._recovery.refusals,
            },
            up=self._world.up(origin),
            fused=self._observations(tracks),
            events=tuple(self._recovery.events + self._events),
            fit=fit,
            lagged=lagged,
        )

    def _drive(self, tracks: list[Track]) -> Drive:
        """The problem that the estimate in the end is of."""
        rig, others = self._problem.rig, None
        if self._options.final == "relinearised" and not self._stereo.repeated:
            # The factors of the tree, each with biases and shared errors as known when it came.
            assert isinstance(self._solver.engine, WholeGraph)
            others = self._solver.engine.without_landmarks()
        return Drive(rig, self._motion, self._stereo, self._frames, tracks, others)

    def _lagged_poses(self) -> Array:
        """Poses ``(T, 4, 4)`` of a lag: as they were when they left it, and those that are still held."""
        solver, between = self._solver, self._between
        if not between.any:
            return np.array([*solver.left, *(solver.reported(k) for k in solver.held())])
        known = [
            *self._left,
            *(between.state(solver.engine, k) for k in range(len(self._left), len(solver.poses))),
        ]
        return np.array([state.pose for state in between.filled(known)])

    def _observations(self, tracks: Collection[Track]) -> tuple[IntArray, IntArray]:
        """Frames and track ids ``(n,)`` of all observations that are fused."""
        frames, ids = self._solver.tracks.past.observations
        frame = np.array([view.k for track in tracks for view in track.views], dtype=np.int64)
        track = np.array([track.id for track in tracks for _ in track.views], dtype=np.int64)
        return np.concatenate([self._between.places(frames), frame]), np.concatenate([ids, track])

    def _covariances(self, drive: Drive, values: gtsam.Values, points: Array) -> tuple[Array, Array | None]:
        """Covariances of all poses and, if asked for, landmarks ``(n, 3)``, in the world that is reported."""
        world, landmarks = self._world, self._options.marginals == "all"
        firsts = shared_keys(world, self._motion, 0)
        found = drive.marginals(values, firsts, landmarks=landmarks)
        if not world.own:
            return found.poses, found.points if landmarks else None
        known = GraphCovariances(found.poses, found.poses_shared, found.shared)
        if self._motion.rotation(0) != self._motion.rotation(1):
            known = self._with_own_rotations(drive, values, found.poses)
        poses, rotation = drive.poses(values), self._rotations(drive, values)
        origin = Origin(poses[0], rotation[0])
        pose_cov = world.pose_covariances(origin, poses, rotation, known)
        if not landmarks:
            return pose_cov, None
        of_points = GraphCovariances(found.points, found.points_shared, found.shared)
        return pose_cov, world.point_covariances(origin, points, of_points)

    def _with_own_rotations(self, drive: Drive, values: gtsam.Values, own: Array) -> GraphCovariances:
        """Covariances ``(T, 6, 6)`` of the poses, and those with the rotation of their frame, which walks."""
        t, m = len(own), 12 if self._world.tilted else 6
        cross, shared = np.zeros((t, 6, m)), np.zeros((t, m, m))
        later = range(1, t)
        groups = [[*shared_keys(self._world, self._motion, k), X(k)] for k in later]
        for k, joint in zip(later, drive.joint_covariances(values, groups), strict=True):
            cross[k], shared[k] = joint[m:, :m], joint[:m, :m]
        return GraphCovariances(own, cross, shared)

    def _rotations(self, drive: Drive, values: gtsam.Values) -> Array:
        """Rotations ``(T, 3)`` of the cameras at all frames, 0 where they are known."""
        keys = [self._motion.rotation(k) for k in range(len(drive.frames))]
        found = [np.zeros(3) if key is None else values.atVector(key) for key in keys]
        return np.array(found).reshape(-1, 3)

    def _read(self, k: int, with_cov: bool) -> tuple[Array, Array | None]:
        """Pose of a frame as known now, or as it was when it left a lag, which leaves no covariance."""
        solver = self._solver
        if k < solver.held().start:
            return solver.left[k], None
        cov = None
        if with_cov:
            # What cannot be told of a covariance beside a marginal is no fault of the estimate.
            with suppress(IndeterminateError):
                cov = solver.covariance(k)
        return solver.reported(k), cov

    def _finish(self, drive: Drive) -> gtsam.Values:
        """Do what the options ask for in the end, and return the estimate."""
        options = self._options
        budget = Budget(options.max_iterations, options.budget_s, tell=self.tell)
        if options.final == "relinearised":
            return self._or_restarted(drive, self._relinearised(drive, budget), budget)
        values = self._solver.engine.estimate()
        if options.final != "as_is":
            if options.final == "gnc":
                values, self._counts["outliers"] = drive.graduate(values, budget)
            found = drive.optimise(values, options, budget)
            values, self._counts["optimisation_rounds"] = found.values, found.rounds
            self._counts["optimisation_iterations"] = budget.done
            if found.stopped:
                cost = f"cost {found.cost:.6g}, still falling by {budget.fall:.3g} an iteration"
                self._events.append(f"{_stopped(options.final, budget, found.stopped)}, {cost}")
            elif not found.converged:
                self._events.append(f"the cost did not converge in {found.rounds} rounds of optimisation")
            if options.plain:
                values = self._or_restarted(drive, values, budget)
        return values

    def _relinearised(self, drive: Drive, budget: Budget) -> gtsam.Values:
        """Return the estimate with everything relinearised, as often as the options ask for."""
        engine = self._solver.engine
        assert isinstance(engine, WholeGraph)
        found = relinearised(engine, drive, self._options, budget)
        self._counts["final_iterations_undone"] += found.undone
        if found.stopped:
            self._events.append(_stopped("relinearised", budget, found.stopped))
        return found.values

    def _or_restarted(self, drive: Drive, values: gtsam.Values, budget: Budget) -> gtsam.Values:
        """Return the estimate, or one re-initialised from the inertial path where it is worse than that."""
        found = restarted(drive, values, self._problem, self._options, budget)
        if found is None:
            return values
        self._events.append("the estimate had diverged: re-initialised from the inertial path")
        return found


def _stopped(what: str, budget: Budget, by: str) -> str:
    return f"{what}: stopped after {budget.done} iterations ({by})"


def _estimated(problem: Problem, options: SmootherOptions) -> Collection[str]:
    """Shared errors that are variables."""
    if options.motion == "between":
        return ()
    return SIZES if problem.imu is None else OF_PIXELS


def _noise(options: SmootherOptions) -> str:
    return "independent" if options.factors == "stereo" else "independent, rows as noisy as columns"
