"""The multi-state constraint Kalman filter, one frame at a time: clone, predict, fuse ended tracks, slide."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from vislam.base.distributions import chi2_quantile
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.estimator import Problem, shared_information
from vislam.core.frame import Frame
from vislam.core.lagged import LagReader
from vislam.core.step import Final, Step
from vislam.core.trajectory import Landmarks, Poses
from vislam.estimators.ekf import motion, parametrisation
from vislam.estimators.ekf.measurement import Camera
from vislam.estimators.ekf.observability import free_motions
from vislam.estimators.ekf.propagation import reported
from vislam.estimators.msckf.options import MsckfOptions
from vislam.estimators.msckf.pending import Packed, Pending
from vislam.estimators.msckf.projection import POINT, Constraints, eliminate, linearise
from vislam.estimators.msckf.reweighting import student
from vislam.estimators.msckf.window import Window
from vislam.models.kernel import kernel_name
from vislam.models.shared_errors import OF_CAMERA

_NEVER = -1


class MsckfEstimator:
    """Navigation state and a window of past poses; tracks are constraints between them.

    A. I. Mourikis and S. I. Roumeliotis, *A multi-state constraint Kalman filter for vision-aided inertial
    navigation* (ICRA 2007), on the comparison's models of motion and stereo camera. A track is fused once,
    with all its observations, when it ends, when it is as long as allowed, or when its first pose is about to
    leave the window; its landmark is triangulated, eliminated, and never part of the state. One that goes on
    after that goes on as another track, and so does one that comes back.

    Attributes
    ----------
    window : Window
    """

    def __init__(self, problem: Problem, options: MsckfOptions) -> None:
        self._problem = problem
        self._options = options
        self._motion = motion.make(problem)
        self.upright = problem.imu is not None
        start = motion.navigation(problem, self._motion)
        self._camera = Camera(problem.rig, parametrisation.make("point", problem.rig), start.layout)
        self.window = Window(
            start.layout, options.error, nav=start.nav, cov=start.cov, world_T_imu=start.world_T_imu
        )
        self._free = free_motions(start.layout)
        self._longest = options.window + 1 if options.max_length is None else options.max_length
        self._gates = options.gate and problem.gate_probability < 1.0
        self._pending = Pending()
        self._past: list[tuple[Array, Array]] = []
        self._between: set[int] = set()
        self._lags = None if problem.lags is None else LagReader(problem.lags)
        self._fused: list[Packed] = []
        self._gated: list[Packed] = []
        self._points: dict[int, Array] = {}
        self._counts = {"tracks_too_short": 0, "tracks_not_triangulated": 0, "tracks_rejected": 0}
        if problem.kernel is not None:
            self._counts["reweightings_not_converged"] = 0
        self.information = {
            "noise of the tracks": "independent",
            "kernel": kernel_name(problem.kernel),
            **shared_information(problem, estimated=list(start.layout)),
            **self._motion.information,
        }
        if any(prior.walk > 0.0 for name, prior in problem.shared().items() if name in OF_CAMERA):
            self.information["walk of shared errors"] = "neglected between the frames of a track"
        if problem.kept:
            self.information["landmarks seen again"] = "taken for new ones"

    def process(self, frame: Frame) -> Step:
        """Take one frame."""
        self._move(frame)
        if not frame.keyframe:
            return Step(
                pose=self.window.poses[-1].copy(),
                pose_cov=self.window.pose_cov(-1),
                states=reported(self._motion, self.window.layout, self.window.nav, self.window.cov),
            )
        gained = self._measure(frame)
        self._pending.take(frame)
        full = self._keyframes(self.window.frames) > self._options.window
        ended = self._pending.release(
            frame.stereo.track, longest=self._longest, oldest=int(self.window.frames[0]) if full else _NEVER
        )
        fused = self._fuse(ended)
        if self._lags is not None:
            self._lags.take(frame.k, self._read)
        return Step(
            pose=self.window.poses[-1].copy(),
            pose_cov=self.window.pose_cov(-1),
            states=reported(self._motion, self.window.layout, self.window.nav, self.window.cov),
            nis=fused.nis,
            dof=fused.dof,
            used=_of_the_frame(fused.tracks, frame),
            gated=_of_the_frame(fused.gated, frame),
            spurious_information=(gained + fused.spurious_information) * self._free,
        )

    def finalize(self) -> Final:
        """Fuse what is still in view; return each pose as known when it left the window, or at the end."""
        self._fuse(self._pending.release(np.empty(0, np.int64), longest=self._longest, oldest=_NEVER))
        last = [(pose, self.window.pose_cov(place)) for place, pose in enumerate(self.window.poses)]
        known = self._past + last
        tracks = np.array(sorted(self._points), np.int64)
        return Final(
            trajectory=Poses(np.array([pose for pose, _ in known]), np.array([cov for _, cov in known])),
            map=Landmarks(tracks, np.array([self._points[track] for track in tracks]).reshape(-1, 3)),
            fused=_pairs(self._fused),
            gated=_pairs(self._gated),
            counts=dict(self._counts),
            up=self._motion.up(self.window.layout, self.window.nav),
            lagged={} if self._lags is None else self._lags.finish(self._read),
        )

    def _move(self, frame: Frame) -> None:
        """Clone the pose, let the oldest clones go if there are too many keyframes, and predict.

        Between keyframes poses are cloned, too, for what later ones tell of them.
        """
        window = self.window
        if not frame.keyframe:
            self._between.add(frame.k)
        if frame.k == 0:
            window.nav = self._motion.first(window.layout, window.nav, frame)
            return
        window.clone()
        clones = window.frames[:-1]
        while self._keyframes(clones) > self._options.window or int(clones[0]) in self._between:
            self._past.append((window.poses[0].copy(), window.pose_cov(0)))
            window.keep(np.arange(len(clones)) > 0)
            clones = clones[1:]
        step = self._motion.propagate(window.layout, window.poses[-1], window.nav, frame)
        window.predict(step, frame.k)

    def _keyframes(self, frames: IntArray) -> int:
        """How many of some frames are keyframes."""
        return sum(frame not in self._between for frame in frames.tolist())

    def _measure(self, frame: Frame) -> Array:
        """Fuse what the model of motion measures; returns what it gained on motions of the world ``(6,)``."""
        window, gained = self.window, np.zeros(6)
        for found in self._motion.measurements(window.layout, window.poses[-1], window.nav, frame):
            jacobian = np.zeros((len(found.innovation), len(window.cov)))
            jacobian[:, : window.layout.size] = found.by_nav
            gained += np.sum((jacobian @ window.directions) ** 2 / found.variance[:, None], axis=0)
            window.correct(jacobian, found.innovation, found.variance)
        return gained

    def _fuse(self, ended: Packed) -> "_Fused":
        """Fuse tracks that have ended."""
        tracks, constraints = self._triangulated(ended)
        passes = self._passes(tracks, constraints)
        gated, tracks = tracks.part(~passes), tracks.part(passes)
        self._gated.append(gated)
        self._fused.append(tracks)
        if not len(tracks):
            return _Fused(tracks, gated)
        if not passes.all():
            constraints = constraints.part(passes)
        self._points.update(zip(tracks.track.tolist(), constraints.points_world, strict=True))
        kernel = self._problem.kernel
        if kernel is None:
            projected = eliminate(constraints, tracks.seen.astype(np.float64))
        else:
            projected, converged = student(kernel, constraints, tracks.seen, self.window.cov)
            self._counts["reweightings_not_converged"] += not converged
        jacobian, residual, rest = projected.stacked()
        gained = np.sum((jacobian @ self.window.directions) ** 2, axis=0)
        update = self.window.correct(jacobian, residual, np.ones(len(residual)))
        if kernel is not None:
            # Weighted residuals are no chi-square numbers.
            return _Fused(tracks, gated, spurious_information=gained)
        dof = int(np.sum(3 * tracks.length - POINT))
        return _Fused(tracks, gated, nis=update.nis + rest, dof=dof, spurious_information=gained)

    def _triangulated(self, ended: Packed) -> tuple[Packed, Constraints]:
        """Tracks that are long enough and have a landmark, linearised; the others are counted."""
        long = ended.length >= self._options.min_length
        self._counts["tracks_too_short"] += int(np.count_nonzero(~long))
        tracks = ended.part(long)
        constraints = linearise(self._camera, self.window, tracks)
        solved = constraints.solved
        self._counts["tracks_not_triangulated"] += int(np.count_nonzero(~solved))
        return (tracks, constraints) if solved.all() else (tracks.part(solved), constraints.part(solved))

    def _passes(self, tracks: Packed, constraints: Constraints) -> BoolArray:
        """Which tracks the gate lets pass; the others are counted."""
        if not (self._gates and len(tracks)):
            return np.ones(len(tracks), bool)
        most = chi2_quantile(self._problem.gate_probability, 3 * tracks.length - POINT)
        projected = eliminate(constraints, tracks.seen.astype(np.float64))
        passes = projected.distances(self.window.cov) <= most
        self._counts["tracks_rejected"] += int(np.count_nonzero(~passes))
        return np.asarray(passes)

    def _read(self, k: int, with_cov: bool) -> tuple[Array, Array | None]:
        """Pose ``(4, 4)`` of a frame as known now, or when it left the window, and its covariance."""
        if k < len(self._past):
            pose, cov = self._past[k]
            return pose, cov if with_cov else None
        place = k - len(self._past)
        return self.window.poses[place].copy(), self.window.pose_cov(place) if with_cov else None


@dataclass(frozen=True)
class _Fused:
    """Tracks that an update fused and gated, its NIS, and the information gained on motions of the world."""

    tracks: Packed
    gated: Packed
    nis: float = 0.0
    dof: int = 0
    spurious_information: Array = field(default_factory=lambda: np.zeros(6))


def _of_the_frame(tracks: Packed, frame: Frame) -> BoolArray:
    """Which observations ``(n,)`` of a frame are among those of some tracks."""
    at, track = tracks.pairs()
    return np.isin(frame.stereo.track, track[at == frame.k])


def _pairs(parts: Sequence[Packed]) -> tuple[IntArray, IntArray]:
    """Frames and tracks of all observations."""
    pairs = [part.pairs() for part in parts]
    none = np.empty(0, np.int64)
    return (
        np.concatenate([none, *(frame for frame, _ in pairs)]),
        np.concatenate([none, *(track for _, track in pairs)]),
    )
