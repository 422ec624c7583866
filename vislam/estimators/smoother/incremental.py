"""Smoothing SLAM, one frame at a time, with GTSAM doing the solving."""

import logging
from contextlib import suppress
from dataclasses import replace

import gtsam
import numpy as np

from vislam.base.types import Array
from vislam.core.estimator import Problem
from vislam.core.frame import Frame
from vislam.core.lagged import LagReader
from vislam.core.step import Final, State, Step
from vislam.core.trajectory import Landmarks, Poses
from vislam.estimators.smoother import motion
from vislam.estimators.smoother.batch import Drive
from vislam.estimators.smoother.descent import Budget, Tell
from vislam.estimators.smoother.engine import IndeterminateError
from vislam.estimators.smoother.factors import StereoFactors
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.recovery import Recovery
from vislam.estimators.smoother.restart import restarted
from vislam.estimators.smoother.solver import Solver
from vislam.estimators.smoother.world import ReportedWorld
from vislam.models.kernel import kernel_name

_log = logging.getLogger("vislam.estimators.smoother")


class SmootherEstimator:
    """Poses, twist biases and landmarks in one graph, of the whole sequence or of a lag.

    Only variables observed in the last frames are relinearised in between: the linearisation of what lies
    behind hardly matters for what comes, and redoing it costs the whole tree. In the end everything is.

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
        self._lags = None if problem.lags is None else LagReader(problem.lags)
        self._problem, self._options = problem, options
        kernel = problem.kernel if options.plain else None
        self._gaussian = options.plain and kernel is None
        self._motion = motion.make(problem, between=options.motion == "between")
        self.upright = problem.imu is not None
        self.information = {
            "noise of the tracks": _noise(options),
            "kernel": "truncated least squares" if options.final == "gnc" else kernel_name(kernel),
            **self._motion.information,
        }
        self._stereo = StereoFactors(problem.rig, kernel=kernel)
        self._world = ReportedWorld(problem)
        self._solver = Solver(
            problem.rig, options, self._motion, self._stereo, world=self._world, comes_back=problem.kept > 0
        )
        self._recovery = Recovery(problem.rig, options, self._solver)
        self._frames: list[Frame] = []
        self._events: list[str] = []
        self._counts = {"observations_used_late": 0, "final_iterations_undone": 0}

    def process(self, frame: Frame) -> Step:
        """Take one frame."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in self._motion.factors(frame, self._frames[-1] if self._frames else None):
            graph.add(factor)
        solver = self._solver
        self._frames.append(frame)
        solver.predict(frame)
        self._motion.insert(values, frame, solver.poses[-1])
        sights = [(track, track.views[-1]) for track in solver.tracks.take(frame, oldest=solver.held().start)]
        for track in solver.start():
            values.insert(track.key, track.point)
            sights += [(track, view) for view in track.views]
        for track, view in sights:
            graph.add(self._stereo.stereo(view.k, track.key, z=view.z, sigma=view.sigma))
        owners = [track for track, _ in sights]
        now = list({track.id: track for track in owners}.values())
        self._counts["observations_used_late"] += len(owners) - len(now)
        solver.keep_leaving(frame)
        try:
            solver.update(frame, graph, values, owners, now)
        except IndeterminateError as error:
            self._recovery.repeat(frame, error)
        self._recovery.go_on(frame)
        seen = [track for track in now if track.id in solver.tracks.in_view]
        solver.find_degenerate(seen)
        if self._lags is not None:
            self._lags.take(frame.k, self._read)
        every = self._options.pose_cov_every
        states, pose_cov = self._read_newest(frame, with_cov=every > 0 and frame.k % every == 0)
        return Step(
            pose=solver.reported(solver.poses[-1]),
            pose_cov=pose_cov,
            states=states,
            used=np.isin(frame.stereo.track, [track.id for track in seen]),
        )

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
        tracks = solver.tracks.landmarks
        pose_cov = points_cov = fit = None
        if options.lag_s is not None:
            first = solver.first()
            held = [solver.engine.pose(X(k)) for k in solver.held()]
            poses = np.array([*solver.left, *self._world.poses(first, np.array(held).reshape(-1, 4, 4))])
            points = np.array([track.point for track in tracks]).reshape(-1, 3)
            points = self._world.points(first, points)
        else:
            drive = Drive(self._problem.rig, self._motion, self._stereo, self._frames, tracks)
            values = self._finish(drive)
            tracks = drive.tracks
            poses = drive.poses(values)
            points = np.array([values.atPoint3(track.key) for track in tracks]).reshape(-1, 3)
            first = poses[0] if len(poses) else np.eye(4)
            poses, points = self._world.poses(first, poses), self._world.points(first, points)
            if self._gaussian:
                fit = drive.fit(values)
            if options.marginals != "none" and len(poses):
                pose_cov, points_cov = self._covariances(drive, values, poses, points)
        fused = [*tracks, *solver.tracks.former]
        return Final(
            trajectory=Poses(poses.reshape(-1, 4, 4), pose_cov),
            map=Landmarks(np.array([track.id for track in tracks], dtype=np.int64), points, points_cov),
            counts={
                "landmarks_too_weak": solver.tracks.too_weak + len(solver.tracks.waiting),
                "landmarks_rejected": solver.tracks.rejected,
                "observations_dropped_pending": solver.tracks.views_dropped,
                **self._counts,
                "recoveries": self._recovery.recoveries,
                "steps_by_qr": self._recovery.by_qr,
                "cholesky_failures": self._recovery.refusals,
            },
            up=self._world.up(first),
            fused=(
                np.array([view.k for track in fused for view in track.views], dtype=np.int64),
                np.array([track.id for track in fused for _ in track.views], dtype=np.int64),
            ),
            events=tuple(self._recovery.events + self._events),
            fit=fit,
            lagged=lagged,
        )

    def _covariances(
        self, drive: Drive, values: gtsam.Values, poses: Array, points: Array
    ) -> tuple[Array, Array | None]:
        """Covariances of all poses and, if asked for, landmarks, in the world that is reported."""
        found, landmarks = drive.marginals(values), self._options.marginals == "all"
        pose_cov, points_cov = found.poses, found.points
        if self._world.tilted:
            first, first_cov = values.atPose3(X(0)).matrix(), found.poses[0]
            pose_cov = self._world.pose_covariances(poses, pose_cov, found.poses_first, first_cov)
            if landmarks:
                cross = found.points_first
                points_cov = self._world.point_covariances(points, points_cov, cross, first_cov, first)
        return pose_cov, points_cov if landmarks else None

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
        return solver.reported(solver.engine.pose(X(k))), cov

    def _finish(self, drive: Drive) -> gtsam.Values:
        """Do what the options ask for in the end, and return the estimate."""
        options, values = self._options, self._solver.engine.estimate()
        budget = Budget(options.max_iterations, options.budget_s, tell=self.tell)
        if options.final == "relinearised":
            for _ in range(options.final_iterations):
                if budget.spent:
                    self._events.append(_stopped("relinearised", budget, budget.spent))
                    break
                try:
                    self._solver.engine.converge()
                    values = self._solver.engine.estimate()
                except IndeterminateError:
                    self._counts["final_iterations_undone"] += 1
                    break
                budget.count("relinearised")
            values = self._or_restarted(drive, values, budget)
        elif options.final != "as_is":
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

    def _or_restarted(self, drive: Drive, values: gtsam.Values, budget: Budget) -> gtsam.Values:
        """Return the estimate, or one re-initialised from the inertial path where it is worse than that."""
        found = restarted(drive, values, self._problem, self._options, budget)
        if found is None:
            return values
        self._events.append("the estimate had diverged: re-initialised from the inertial path")
        return found


def _stopped(what: str, budget: Budget, by: str) -> str:
    return f"{what}: stopped after {budget.done} iterations ({by})"


def _noise(options: SmootherOptions) -> str:
    return "independent" if options.factors == "stereo" else "independent, rows as noisy as columns"
