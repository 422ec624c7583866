"""The incremental solution: the tracks and poses that an engine holds, its updates, building it anew."""

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from typing import Literal

import gtsam
import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.core.frame import Frame
from vislam.estimators.smoother import engine
from vislam.estimators.smoother.engine import Engine, WholeGraph
from vislam.estimators.smoother.factors import StereoFactors
from vislam.estimators.smoother.keys import X, is_landmark
from vislam.estimators.smoother.linearity import neglected
from vislam.estimators.smoother.marginal import collected
from vislam.estimators.smoother.motion import Motion, newest
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.tracks import Track, Tracks
from vislam.estimators.smoother.tree import IndeterminateError
from vislam.estimators.smoother.values import only
from vislam.estimators.smoother.world import GraphCovariances, Origin, ReportedWorld
from vislam.geometry import se3
from vislam.models import StereoRig

_TURNED, _MOVED = 0.05, 0.1
"""A solution that turned the newest pose by more [rad], or moved it by more than this share of the median
depth in view, is beyond what one linearisation is good for."""
_ITERATIONS = 5
"""Relinearisations after one step, at most."""

Settled = Literal["whole", "recent"]
"""What was relinearised after a step: everything, or what was observed last."""


class Solver:
    """An engine with the tracks and poses that it holds.

    Attributes
    ----------
    engine : Engine
    factorization : str
        That of the engine, qr or cholesky; the next :meth:`rebuild` makes one with it.
    tracks : Tracks
    poses : list of (4, 4)
        Causal poses of all frames so far, the newest a prediction until it is solved.
    left : list of (4, 4)
        Of a lag, the poses as they were when they left it, in the world that is reported.
    """

    def __init__(
        self,
        rig: StereoRig,
        options: SmootherOptions,
        motion: Motion,
        stereo: StereoFactors,
        *,
        world: ReportedWorld,
        comes_back: bool = False,
    ) -> None:
        self._rig, self._options, self._motion, self._stereo = rig, options, motion, stereo
        self._world = world
        self.factorization = "qr" if options.factorization == "qr" else "cholesky"
        self.engine = self._made()
        self.tracks = Tracks(comes_back=comes_back)
        self.poses: list[Array] = []
        self.left: list[Array] = []
        self._stamps: list[float] = []
        # Landmarks seen in each of the last frames, and slots of factors that the next update takes out.
        self._recent: list[list[Track]] = []
        self._remove: list[int] = []

    def predict(self, frame: Frame) -> None:
        """Append the predicted pose of a frame."""
        self._stamps.append(frame.stamp)
        self.poses.append(self._motion.predict(frame, self.poses[-1] if self.poses else np.eye(4)))

    def start(self) -> list[Track]:
        """Make landmarks of the waiting tracks whose depth has become clear, and return them."""
        return self.tracks.start(
            self._rig,
            self._stereo.errors,
            self.poses,
            clear=self._options.initialisation_snr,
            most=self._options.max_pending_observations,
            oldest=self.held().start,
        )

    def held(self) -> range:
        """Frames whose poses the solver still holds after the newest frame."""
        lag, newest = self._options.lag_s, len(self._stamps)
        if lag is None:
            return range(newest)
        return range(bisect_left(self._stamps, self._stamps[-1] - lag), newest)

    def keep_leaving(self, frame: Frame) -> None:
        """Read the poses that the update with this frame will marginalise."""
        if self._options.lag_s is not None:
            for k in range(len(self.left), min(self.held().start, frame.k)):
                self.left.append(self.reported(k))

    def origin(self) -> Origin:
        """What poses are reported by, as known now."""
        pose = self.engine.pose(X(0)) if self._world.tilted else np.eye(4)
        return Origin(pose, self.rotation(0))

    def rotation(self, k: int) -> Array:
        """Rotation ``(3,)`` of the cameras at a frame, 0 where it is known."""
        key = self._motion.rotation(k)
        return np.zeros(3) if key is None else self.engine.vector(key)

    def reported(self, k: int) -> Array:
        """Pose ``(4, 4)`` of a frame in the world that is reported, as known now."""
        return self._world.poses(self.origin(), self.engine.pose(X(k)), self.rotation(k))

    def covariance(self, k: int) -> Array:
        """Covariance ``(6, 6)`` of the pose of a frame in the world that is reported."""
        if not self._world.own:
            return self.engine.covariance(X(k))
        shared = shared_keys(self._world, self._motion, k)
        if k == 0 and self._world.tilted:
            # Known by its prior, whatever the tilt.
            joint = self.engine.joint_covariance(shared)
            joint = joint[np.ix_(*[np.r_[: len(joint), :6]] * 2)]
        else:
            joint = self.engine.joint_covariance([*shared, X(k)])
        known = GraphCovariances(joint[None, -6:, -6:], joint[None, -6:, :-6], joint[:-6, :-6])
        pose, rotation = self.engine.pose(X(k))[None], self.rotation(k)[None]
        found = self._world.pose_covariances(self.origin(), pose, rotation, known)
        return np.asarray(found[0])

    def update(
        self,
        frame: Frame,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        owners: Sequence[Track],
        now: list[Track],
    ) -> None:
        """Update the engine with a frame, whose stereo factors are of ``owners``, and read its pose.

        Parameters
        ----------
        frame : Frame
        graph, values
            Its factors, the stereo ones last, and first values of its variables.
        owners : sequence of Track
            Whose the stereo factors are, in their order.
        now : list of Track
            Landmarks that it sees.

        Raises
        ------
        IndeterminateError
            If GTSAM cannot solve it. Its factors are in the engine all the same.
        """
        remove, self._remove = self._remove, []
        if self._options.relinearises(frame.k):
            for track in self.tracks.in_view.values():
                track.linearised = track.point
        try:
            slots = self.engine.update(
                graph,
                values,
                stamps=self._stamps_of(frame, now),
                newest=self._newest(frame),
                in_view=[track.key for track in now],
                resting=self._resting(now),
                remove=remove,
            )
        except IndeterminateError:
            # They are in the solver all the same, behind all others.
            _place(owners, list(self.engine.factors()))
            raise
        _place(owners, slots)
        self._read(frame)

    def settle(self, frame: Frame, before: Array, seen: Sequence[Track]) -> Settled | None:
        """Relinearise while the estimate is beyond what its linearisation is good for.

        Everything, while the newest pose moves far: what rests stays where it was linearised, and with little
        in view for some time, or where a landmark is re-observed, one step corrects much of the trajectory.
        What was observed last, while what the newest observations neglect is not small: a landmark or a pose
        was first placed too far from where it is now.

        Parameters
        ----------
        frame : Frame
            The newest, solved once.
        before : (4, 4)
            Its pose before that, at which it is linearised.
        seen : sequence of Track
            Landmarks that it observes.

        Returns
        -------
        Settled or None
            What was necessary, if anything was.

        Raises
        ------
        IndeterminateError
            If GTSAM cannot solve it.
        """
        beyond = self._options.relinearize_beyond
        if beyond is None:
            return None
        limit = np.repeat([_TURNED, _MOVED * self._depth_in_view(frame)], 3)
        found: Settled | None = None
        for _ in range(_ITERATIONS):
            pose, points = self.poses[-1], self.engine.points([track.key for track in seen])
            moved = se3.local(before, pose) / limit
            if max(np.linalg.norm(moved[:3]), np.linalg.norm(moved[3:])) > 1.0:
                wanted: Settled = "whole"
            elif beyond != "far" and self._neglects(seen, points, pose, before) > beyond:
                wanted = "recent"
            else:
                break
            if not self._relinearise(frame, whole=wanted == "whole"):
                break
            found = wanted if found is None or wanted == "whole" else found
            before = pose
            for track, point in zip(seen, points, strict=True):
                track.linearised = point
            self._read(frame)
        return found

    def _relinearise(self, frame: Frame, *, whole: bool) -> bool:
        """Relinearise the whole graph or its recent part; of a lag, everything that it holds, if it can be.

        A lag is rebuilt at its estimate, its marginals taken over as quadratics with the point that they
        are of. Were what they tie held where it was first linearised, a landmark that stays in view for
        longer than the lag would be, whatever its estimate has become: next to landmarks a metre or two away,
        each relinearisation of the others would then ask for a larger correction than the one before it.
        """
        if isinstance(self.engine, WholeGraph):
            (self.engine.converge if whole else self.engine.relinearise)()
            return True
        before = self.engine
        try:
            self.rebuild(frame, before.factors(), before.estimate(), {})
        except IndeterminateError:
            # A landmark that is degenerate at the estimate has no factor there. The step was solved before:
            # it is that landmark that has to go, and tracks know where their factors are in that engine.
            self.engine = before
            return False
        return True

    def _neglects(self, seen: Sequence[Track], points: Array, pose: Array, linearised: Array) -> float:
        """Most that the linearisation of a newest observation neglects, in standard deviations.

        In those of the noise, or of what the linear problem leaves of all newest observations, if that is
        more: what does not fit where all is linear is an outlier or noise that is understated, and there one
        relinearisation asks for the next.

        Nothing where a landmark has become degenerate: its factors are taken out with the next update, and
        what they did to the rest goes with them, unless that is relinearised there.
        """
        if not seen or not self._plausible(points, pose).all():
            return 0.0
        found, left = neglected(self._rig, seen, points=points, pose=pose, linearised=linearised)
        return float(found.max() / max(1.0, np.sqrt(np.mean(left**2))))

    def _depth_in_view(self, frame: Frame) -> float:
        """Median depth of what a frame sees [m]; infinite if it sees nothing."""
        z = frame.stereo.z[frame.stereo.usable]
        if not len(z):
            return np.inf
        disparity = max(float(np.median(z[:, 0] - z[:, 1])), self._options.min_disparity_px)
        return self._rig.fx * self._rig.baseline / disparity

    def reject(self, tracks: Sequence[Track]) -> None:
        """Fuse these tracks no more, and take their factors out with the next update."""
        self.tracks.reject(tracks)
        for track in tracks:
            self._remove += track.slots

    def find_degenerate(self, seen: Sequence[Track]) -> None:
        """Set aside landmarks that came to lie behind the camera, in it, or on their way to infinity.

        A stereo factor whose point is behind the camera has no Jacobian, and the system loses rank; a
        point gets there through infinity as easily as through the camera.
        """
        points = self.engine.points([track.key for track in seen])
        for track, point in zip(seen, points, strict=True):
            track.point = point
        self.reject(
            [
                track
                for track, good in zip(seen, self._plausible(points, self.poses[-1]), strict=True)
                if not good
            ]
        )

    def strange(self, point: gtsam.Values) -> list[Track]:
        """Landmarks of the solver that lie where who saw them last cannot have seen them."""
        held = [track for track in self.tracks.landmarks if point.exists(track.key)]
        if not held:
            return []
        seen_from = [X(track.views[-1].k) for track in held]
        poses = [
            point.atPose3(key).matrix() if point.exists(key) else self.poses[track.views[-1].k]
            for key, track in zip(seen_from, held, strict=True)
        ]
        where = np.array([point.atPoint3(track.key) for track in held])
        good = self._plausible(where[:, None], np.array(poses))[:, 0]
        return [held[index] for index in np.flatnonzero(~good)]

    def rebuild(
        self,
        frame: Frame,
        held: Mapping[int, gtsam.NonlinearFactor],
        point: gtsam.Values,
        poses: Mapping[int, Array],
    ) -> None:
        """Build the engine anew from factors that it held, and read the newest frame.

        Parameters
        ----------
        frame : Frame
            The newest.
        held : mapping of int to gtsam.NonlinearFactor
            The factors, by slot.
        point : gtsam.Values
            Where they are linearised.
        poses : mapping of int to (4, 4)
            Poses that take the place of those of ``point``, by frame.

        Raises
        ------
        IndeterminateError
            If GTSAM cannot solve it; the tracks are as before.
        """
        gone = set(self._remove)
        kept = [slot for slot in held if slot not in gone]
        graph = collected(held[slot] for slot in kept)
        values = only(point, graph.keyVector())
        for k in self.held():
            if k in poses:
                values.update(X(k), gtsam.Pose3(poses[k]))
        landmarks, stamps = self.tracks.landmarks, self._all_stamps(frame)
        oldest = -np.inf if self._options.lag_s is None else frame.stamp - self._options.lag_s
        # What was rejected may be left in the factors of what has been marginalised, and only in these: they
        # need not determine it.
        left = [key for key in list(values.keys()) if key not in stamps]
        for key in filter(is_landmark, left):
            graph.add(self._stereo.vague(key, values.atPoint3(key)))
        stamps |= dict.fromkeys(left, oldest)
        old = frame.k - self._options.window
        resting = [key for k in self.held() if k <= old for key in self._motion.keys(k)]
        resting += [track.key for track in landmarks if track.views[-1].k <= old]
        self.engine = self._made()
        slots = self.engine.update(
            graph,
            values,
            # What leaves a lag with this frame leaves with the next: it cannot in the update it comes with.
            stamps={key: max(stamp, oldest) for key, stamp in stamps.items() if values.exists(key)},
            newest=self._newest(frame),
            in_view=[track.key for track in self.tracks.in_view.values() if values.exists(track.key)],
            resting=resting,
            remove=[],
        )
        self._read(frame)
        # Not before all went well: else the next try has the factors of this one.
        moved = dict(zip(kept, slots[: len(kept)], strict=True))
        for track in landmarks:
            track.slots = [moved[slot] for slot in track.slots if slot in moved]
        self._remove = []

    def _made(self) -> Engine:
        """Engine that holds nothing yet."""
        return engine.make(
            self._options,
            factorization=self.factorization,
            baseline=self._rig.baseline,
            own=self._motion.thresholds,
        )

    def _read(self, frame: Frame) -> None:
        """Read the newest frame."""
        pose = self.engine.pose(X(frame.k))
        if not np.isfinite(pose).all():
            raise IndeterminateError("the pose is not finite")
        self.poses[-1] = pose
        self._motion.read(self.engine, frame)

    def _stamps_of(self, frame: Frame, seen: Sequence[Track]) -> dict[int, float]:
        """Time of all variables that a frame has or sees."""
        keys = [*self._motion.keys(frame.k), *self._motion.tied(frame.k), *(track.key for track in seen)]
        return dict.fromkeys([*self._always(), *keys], frame.stamp)

    def _newest(self, frame: Frame) -> list[int]:
        """Keys that an update solves for whatever has changed."""
        return list(dict.fromkeys([*newest(self._motion, frame.k), *self._always()]))

    def _always(self) -> list[int]:
        """Keys that are always held and solved: those of the first frame by which poses are reported."""
        first = self._motion.rotation(0)
        return [*([X(0)] if self._world.tilted else []), *([] if first is None else [first])]

    def _all_stamps(self, frame: Frame) -> dict[int, float]:
        """Time of all variables of the frames and tracks that are held."""
        stamps = {key: self._stamps[k] for k in self.held() for key in self._motion.keys(k)}
        stamps |= {track.key: self._stamps[track.views[-1].k] for track in self.tracks.landmarks}
        return stamps | dict.fromkeys([*self._always(), *self._motion.tied(frame.k)], frame.stamp)

    def _resting(self, now: list[Track]) -> list[int]:
        """Variables that were last seen so long ago that they are not relinearised any more."""
        self._recent.append(now)
        if len(self._recent) <= self._options.window:
            return []
        old = len(self._stamps) - 1 - self._options.window
        last_seen = [track.key for track in self._recent.pop(0) if track.views[-1].k == old]
        return [*self._motion.keys(old), *last_seen]

    def _plausible(self, points: Array, world_T_imu: Array) -> BoolArray:
        """Whether points ``(..., n, 3)`` are where a camera can have seen them, poses ``(..., 4, 4)``."""
        rig = self._rig
        depth = se3.transform(rig.cam_T_imu @ se3.inverse(world_T_imu), points)[..., 2]
        return (depth > rig.nearest) & (depth < rig.fx * rig.baseline / self._options.min_disparity_px)


def shared_keys(world: ReportedWorld, motion: Motion, k: int) -> list[int]:
    """Keys of the errors that the covariance of a frame's reported pose shares with those of others."""
    found = [X(0)] if world.tilted else []
    for key in (motion.rotation(0), motion.rotation(k)):
        if key is not None and key not in found:
            found.append(key)
    return found


def _place(owners: Sequence[Track], slots: Sequence[int]) -> None:
    """Note where stereo factors are: the last of the slots, in the order of their tracks."""
    for track, slot in zip(owners, slots[len(slots) - len(owners) :], strict=True):
        track.slots.append(slot)
