"""Smoothing SLAM, one frame at a time, with GTSAM doing the solving."""

import logging
from bisect import bisect_left
from collections.abc import Mapping, Sequence

import gtsam
import numpy as np

from vislam.base.errors import DivergedError
from vislam.base.types import Array, BoolArray
from vislam.core.estimator import Estimate, Problem, StepRecord
from vislam.core.sequence import Frame
from vislam.estimators.smoother import engine
from vislam.estimators.smoother.batch import Drive, only
from vislam.estimators.smoother.descent import Budget, Tell
from vislam.estimators.smoother.engine import IndeterminateError
from vislam.estimators.smoother.factors import FactorBuilder
from vislam.estimators.smoother.keys import CLOCK, W, X, is_landmark
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.tracks import Track, Tracks
from vislam.geometry import se3

_log = logging.getLogger("vislam.estimators.smoother")
_NEAREST = 1.0
"""A landmark nearer than this to the camera that sees it, or behind it, has gone astray [m]."""
_MOST_SUSPECTS = 20
"""A rescue that has set aside this many landmarks looks for no more of those that errors name."""


class SmootherEstimator:
    """Poses, twist biases and landmarks in one graph, of the whole drive or of a lag.

    Only variables seen in the last frames are relinearised on the way: the linearisation of what lies
    behind hardly matters for what comes, and redoing it costs the whole tree. In the end everything is.

    A step that GTSAM cannot solve is not the end. Its factors and its linearisation point are still there,
    and from these, without the landmarks that broke it, the solver is built anew and the step repeated. The
    rescue is counted and told.

    Attributes
    ----------
    tell : callable
        Is given a line after each iteration of the optimisation in the end; by default it is logged.
    """

    def __init__(self, problem: Problem, options: SmootherOptions) -> None:
        self.tell: Tell = _log.info
        self._problem, self._options = problem, options
        self._factors = FactorBuilder(problem, robust=options.robust, threshold=options.robust_threshold)
        self._factorization = "qr" if options.factorization == "qr" else "cholesky"
        self._engine = engine.make(options, factorization=self._factorization)
        self._tracks = Tracks()
        self._frames: list[Frame] = []
        self._stamps: list[float] = []
        # Causal poses, and, of a lag, the poses as they were when they left it.
        self._poses: list[Array] = []
        self._left: list[Array] = []
        self._bias = np.array(problem.bias_mean)
        self._clock = self._height = 0.0
        # Landmarks seen in each of the last frames, and slots of factors that the next update takes out.
        self._recent: list[list[Track]] = []
        self._remove: list[int] = []
        self._events: list[str] = []
        self._counts = {"observations_used_late": 0, "rescues": 0, "final_iterations_undone": 0}

    def process(self, frame: Frame, refused: BoolArray) -> StepRecord:
        """Take one frame."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for factor in self._factors.step(frame, self._frames[-1] if self._frames else None):
            graph.add(factor)
        twist = self._predict(frame)
        self._factors.insert(values, frame, pose=self._poses[-1], twist=twist, height=self._height)
        sights = [(track, track.views[-1]) for track in self._tracks.take(frame, refused)]
        for track in self._start():
            values.insert(track.key, track.point)
            sights += [(track, view) for view in track.views]
        for track, view in sights:
            graph.add(self._factors.stereo(view.k, track.key, z=view.z, sigma=view.sigma))
        owners = [track for track, _ in sights]
        now = list({track.id: track for track in owners}.values())
        self._counts["observations_used_late"] += len(owners) - len(now)
        self._keep_leaving(frame)
        try:
            self._solve(frame, graph, values, owners, now)
        except IndeterminateError as error:
            self._rescue(frame, error)
        seen = [track for track in now if track.id in self._tracks.in_view]
        self._find_astray(seen)
        every = self._options.pose_cov_every
        known = every > 0 and frame.k % every == 0
        return StepRecord(
            world_T_imu=self._poses[-1],
            pose_cov=self._engine.covariance(X(frame.k)) if known else None,
            bias=self._bias,
            bias_sigma=self._bias_sigma(frame) if known else None,
            nis=0.0,
            dof=0,
            log_likelihood=float("nan"),
            used=np.isin(frame.track, [track.id for track in seen]),
            gated=np.zeros(len(frame.track), bool),
        )

    def finalize(self) -> Estimate:
        """Return all poses and landmarks, after what the options ask for in the end."""
        options, tracks = self._options, self._tracks.landmarks
        pose_cov = points_cov = fit = None
        if options.lag_s is not None:
            poses = np.array([*self._left, *(self._engine.pose(X(k)) for k in self._held())])
            points = np.array([track.point for track in tracks]).reshape(-1, 3)
        else:
            drive = Drive(self._problem.rig, self._factors, self._frames, tracks)
            values = self._finish(drive)
            tracks = drive.tracks
            poses = drive.poses(values)
            points = np.array([values.atPoint3(track.key) for track in tracks]).reshape(-1, 3)
            if options.plain:
                fit = drive.fit(values)
            if options.marginals != "none":
                asked = [track.key for track in tracks] if options.marginals == "all" else []
                found = drive.covariances(values, [*(X(k) for k in range(len(poses))), *asked])
                pose_cov = np.array(found[: len(poses)])
                points_cov = np.array(found[len(poses) :]).reshape(-1, 3, 3) if asked else None
        return Estimate(
            world_T_imu=poses.reshape(-1, 4, 4),
            pose_cov=pose_cov,
            track=np.array([track.id for track in tracks], dtype=np.int64),
            points_world=points,
            points_cov=points_cov,
            counts={
                "landmarks_too_weak": self._tracks.too_weak + len(self._tracks.waiting),
                "landmarks_set_aside": self._tracks.set_aside,
                "views_dropped_waiting": self._tracks.views_dropped,
                **self._counts,
            },
            up=None if self._problem.climb is None else np.array([0.0, 0.0, 1.0]),
            fused=(
                np.array([view.k for track in tracks for view in track.views], dtype=np.int64),
                np.array([track.id for track in tracks for _ in track.views], dtype=np.int64),
            ),
            events=tuple(self._events),
            fit=fit,
        )

    def _predict(self, frame: Frame) -> Array:
        """Predict the pose; returns the twist less its bias."""
        self._frames.append(frame)
        self._stamps.append(frame.stamp)
        if frame.k == 0:
            self._poses.append(np.eye(4))
            return np.zeros(6)
        twist = frame.twist + self._clock / frame.dt * frame.twist_change - self._bias
        self._poses.append(self._poses[-1] @ se3.exp(frame.dt * twist))
        if np.isfinite(frame.climb_rate):
            self._height += frame.dt * frame.climb_rate
        return twist

    def _start(self) -> list[Track]:
        return self._tracks.start(
            self._problem.rig,
            self._poses,
            clear=self._options.start_clearance,
            most=self._options.max_waiting_views,
            oldest=self._held().start,
        )

    def _held(self) -> range:
        """Frames whose poses the solver still holds after the newest frame."""
        lag, newest = self._options.lag_s, len(self._frames)
        if lag is None:
            return range(newest)
        return range(bisect_left(self._stamps, self._stamps[-1] - lag), newest)

    def _keep_leaving(self, frame: Frame) -> None:
        """Read the poses that the update with this frame will marginalise."""
        if self._options.lag_s is not None:
            for k in range(len(self._left), min(self._held().start, frame.k)):
                self._left.append(self._engine.pose(X(k)))

    def _solve(
        self,
        frame: Frame,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        owners: Sequence[Track],
        now: list[Track],
    ) -> None:
        """Update the solver with a frame, whose stereo factors are of ``owners``, and read its pose."""
        remove, self._remove = self._remove, []
        try:
            slots = self._engine.update(
                graph,
                values,
                stamps=self._stamps_of(frame, now),
                newest=self._factors.newest(frame.k),
                in_view=[track.key for track in now],
                resting=self._resting(now),
                remove=remove,
            )
        except IndeterminateError:
            # They are in the solver all the same, behind all others.
            _place(owners, range(self._engine.factors().size()))
            raise
        _place(owners, slots)
        self._read(frame)

    def _read(self, frame: Frame) -> None:
        """Read pose, bias and clock of the newest frame."""
        pose = self._engine.pose(X(frame.k))
        if not np.isfinite(pose).all():
            raise IndeterminateError("the pose is not finite")
        self._poses[-1] = pose
        if frame.k > 0:
            if self._problem.clock_sigma > 0.0:
                self._clock = float(self._engine.vector(CLOCK)[0])
            late = self._clock / frame.dt * frame.twist_change
            self._bias = frame.twist + late - self._engine.vector(W(frame.k))

    def _bias_sigma(self, frame: Frame) -> Array:
        """Standard deviation of the bias; the clock's share in that of the twist is left in it."""
        if frame.k == 0:
            return np.array(self._problem.bias_sigma)
        walk = frame.dt * self._problem.noise.bias_walk**2
        return np.sqrt(np.diagonal(self._engine.covariance(W(frame.k))) + walk)

    def _stamps_of(self, frame: Frame, seen: Sequence[Track]) -> dict[int, float]:
        """Time of all variables that a frame has or sees."""
        keys = [*self._factors.keys(frame.k), *self._factors.tied(frame.k), *(track.key for track in seen)]
        return dict.fromkeys(keys, frame.stamp)

    def _resting(self, now: list[Track]) -> list[int]:
        """Variables that were last seen so long ago that they are not relinearised any more."""
        self._recent.append(now)
        if len(self._recent) <= self._options.window:
            return []
        old = len(self._frames) - 1 - self._options.window
        last_seen = [track.key for track in self._recent.pop(0) if track.views[-1].k == old]
        return [*self._factors.keys(old), *last_seen]

    def _find_astray(self, seen: Sequence[Track]) -> None:
        """Set aside landmarks that came to lie behind the camera, in it, or on their way to infinity.

        A stereo factor whose point is behind the camera has no Jacobian, and the system loses rank; a
        point gets there through infinity as easily as through the camera.
        """
        points = self._engine.points([track.key for track in seen])
        for track, point in zip(seen, points, strict=True):
            track.point = point
        self._set_aside(
            [
                track
                for track, good in zip(seen, self._plausible(points, self._poses[-1]), strict=True)
                if not good
            ]
        )

    def _plausible(self, points: Array, world_T_imu: Array) -> BoolArray:
        """Whether points ``(..., n, 3)`` are where a camera can have seen them, poses ``(..., 4, 4)``."""
        rig = self._problem.rig
        depth = se3.transform(rig.cam_T_imu @ se3.inverse(world_T_imu), points)[..., 2]
        return (depth > _NEAREST) & (depth < rig.fx * rig.baseline / self._options.min_disparity_px)

    def _set_aside(self, tracks: Sequence[Track]) -> None:
        self._tracks.put_aside(tracks)
        for track in tracks:
            self._remove += track.slots

    def _rescue(self, frame: Frame, error: IndeterminateError) -> None:
        """Repeat a step without what broke it.

        First with QR, where Cholesky has refused; then without the landmarks that lie where they cannot or
        that the error names, or that of the next try; then without any in view, and from the causal poses.
        """
        held, point = self._engine.factors(), self._engine.linearization_point()
        if self._options.factorization == "auto" and self._factorization == "cholesky":
            self._factorization = "qr"
            self._events.append(f"frame {frame.k}: {error} to Cholesky; QR from here on")
            try:
                self._rebuild(frame, held, point, {})
            except IndeterminateError as again:
                error = again
            else:
                return
        self._counts["rescues"] += 1
        if self._counts["rescues"] > self._options.max_rescues:
            raise DivergedError(f"{error}; it would be rescue {self._counts['rescues']}")
        in_view = [track for track in self._tracks.in_view.values() if point.exists(track.key)]
        suspects = self._strange(point)
        known = {track.key for track in suspects}
        suspects += [track for track in self._named(error) if track.key not in known]
        poses: dict[int, Array] = {}
        gone: list[Track] = []
        while True:
            if suspects or poses:
                found = ", ".join(self._describe(track, point) for track in [*gone, *suspects][:3])
                self._set_aside(suspects)
                gone += suspects
                try:
                    self._rebuild(frame, held, point, poses)
                except IndeterminateError as again:
                    suspects = self._named(again) if len(gone) < _MOST_SUSPECTS else []
                    if suspects:
                        continue
                else:
                    self._events.append(
                        f"frame {frame.k}: {error}; {len(gone)} landmarks set aside, as {found or 'none'}"
                    )
                    return
            if poses:
                raise DivergedError(f"{error}, also without any landmark in view")
            suspects = [track for track in in_view if track.id in self._tracks.in_view]
            poses = dict(enumerate(self._poses))

    def _strange(self, point: gtsam.Values) -> list[Track]:
        """Landmarks of the solver that lie where who saw them last cannot have seen them."""
        held = [track for track in self._tracks.landmarks if point.exists(track.key)]
        if not held:
            return []
        seen_from = [X(track.views[-1].k) for track in held]
        poses = [
            point.atPose3(key).matrix() if point.exists(key) else self._poses[track.views[-1].k]
            for key, track in zip(seen_from, held, strict=True)
        ]
        where = np.array([point.atPoint3(track.key) for track in held])
        good = self._plausible(where[:, None], np.array(poses))[:, 0]
        return [held[index] for index in np.flatnonzero(~good)]

    def _named(self, error: IndeterminateError) -> list[Track]:
        """Landmark that an error names, if it does; it may be out of view by now."""
        return [track for track in self._tracks.landmarks if track.key == error.key]

    def _rebuild(
        self,
        frame: Frame,
        held: gtsam.NonlinearFactorGraph,
        point: gtsam.Values,
        poses: Mapping[int, Array],
    ) -> None:
        """Build the solver anew from factors it held, at ``point`` but for ``poses``, and read it."""
        gone = set(self._remove)
        kept = [slot for slot in range(held.size()) if held.exists(slot) and slot not in gone]
        graph = gtsam.NonlinearFactorGraph()
        for slot in kept:
            graph.push_back(held.at(slot))
        values = only(point, graph)
        for k in self._held():
            if k in poses:
                values.update(X(k), gtsam.Pose3(poses[k]))
        landmarks = self._tracks.landmarks
        stamps = {key: self._stamps[k] for k in self._held() for key in self._factors.keys(k)}
        stamps |= {track.key: self._stamps[track.views[-1].k] for track in landmarks}
        stamps |= dict.fromkeys(self._factors.tied(frame.k), frame.stamp)
        oldest = -np.inf if self._options.lag_s is None else frame.stamp - self._options.lag_s
        # What was set aside may be left in the factors of what has been marginalised, and only in these: they
        # need not determine it.
        left = [key for key in list(values.keys()) if key not in stamps]
        for key in filter(is_landmark, left):
            graph.add(self._factors.vague(key, values.atPoint3(key)))
        stamps |= dict.fromkeys(left, oldest)
        old = frame.k - self._options.window
        resting = [key for k in self._held() if k <= old for key in self._factors.keys(k)]
        resting += [track.key for track in landmarks if track.views[-1].k <= old]
        self._engine = engine.make(self._options, factorization=self._factorization)
        slots = self._engine.update(
            graph,
            values,
            # What leaves a lag with this frame leaves with the next: it cannot in the update it comes with.
            stamps={key: max(stamp, oldest) for key, stamp in stamps.items() if values.exists(key)},
            newest=self._factors.newest(frame.k),
            in_view=[track.key for track in self._tracks.in_view.values() if values.exists(track.key)],
            resting=resting,
            remove=[],
        )
        self._read(frame)
        # Not before all went well: else the next try has the factors of this one.
        moved = dict(zip(kept, slots[: len(kept)], strict=True))
        for track in landmarks:
            track.slots = [moved[slot] for slot in track.slots if slot in moved]
        self._remove = []

    def _describe(self, track: Track, point: gtsam.Values) -> str:
        """Say of a landmark what tells why it broke a step."""
        rig, view = self._problem.rig, track.views[-1]
        disparity = view.z[0] - view.z[1]
        measured = rig.fx * rig.baseline / disparity
        cam_T_world = rig.cam_T_imu @ se3.inverse(self._poses[-1])
        depth = se3.transform(cam_T_world, point.atPoint3(track.key)[None])[0, 2]
        return (
            f"track {track.id} ({len(track.views)} views, disparity {disparity:.1f} px, "
            f"depth {depth:.1f} m for {measured:.1f} m)"
        )

    def _finish(self, drive: Drive) -> gtsam.Values:
        """Do what the options ask for in the end, and return the estimate."""
        options, values = self._options, self._engine.estimate()
        budget = Budget(options.max_iterations, options.budget_s, tell=self.tell)
        if options.final == "relinearised":
            for _ in range(options.final_iterations):
                if budget.spent:
                    self._events.append(_stopped("relinearised", budget, budget.spent))
                    break
                try:
                    self._engine.settle()
                    values = self._engine.estimate()
                except IndeterminateError:
                    self._counts["final_iterations_undone"] += 1
                    break
                budget.count("relinearised")
        elif options.final != "as_is":
            if options.final == "gnc":
                values, self._counts["outliers"] = drive.graduate(values, budget)
            found = drive.optimise(values, options, budget)
            values, self._counts["optimisation_rounds"] = found.values, found.rounds
            self._counts["optimisation_iterations"] = budget.done
            if found.stopped:
                cost = f"cost {found.cost:.6g}, still falling by {budget.fall:.3g} an iteration"
                self._events.append(f"{_stopped(options.final, budget, found.stopped)}, {cost}")
            elif not found.at_rest:
                self._events.append(f"the cost did not rest in {found.rounds} rounds of optimisation")
        return values


def _stopped(what: str, budget: Budget, by: str) -> str:
    return f"{what}: stopped after {budget.done} iterations ({by})"


def _place(owners: Sequence[Track], slots: Sequence[int]) -> None:
    """Note where stereo factors are: the last of the slots, in the order of their tracks."""
    for track, slot in zip(owners, slots[len(slots) - len(owners) :], strict=True):
        track.slots.append(slot)
