"""The multi-state constraint Kalman filter, one frame at a time: clone, predict, fuse ended tracks, slide."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import chi2

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.estimator import Problem
from vislam.core.frame import Frame
from vislam.core.lagged import LagReader
from vislam.core.step import TWIST_BIAS, Final, State, Step
from vislam.core.trajectory import Landmarks, Poses
from vislam.estimators.ekf import motion
from vislam.estimators.msckf.options import MsckfOptions
from vislam.estimators.msckf.pending import Packed, Pending
from vislam.estimators.msckf.projection import Constraints, Projected, eliminate, linearise
from vislam.estimators.msckf.reweighting import student
from vislam.estimators.msckf.window import Window
from vislam.models.kernel import kernel_name

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
        layout, nav, sigma = motion.navigation(problem, self._motion)
        self.window = Window(layout, options.error, nav=nav, sigma=sigma)
        self._longest = options.window + 1 if options.max_length is None else options.max_length
        self._gates = options.gate and problem.gate_probability < 1.0
        self._pending = Pending()
        self._past: list[tuple[Array, Array]] = []
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
            "twist bias": "estimated",
        }
        if problem.kept:
            self.information["landmarks seen again"] = "taken for new ones"

    def process(self, frame: Frame) -> Step:
        """Take one frame."""
        self._move(frame)
        gained = self._measure(frame)
        self._pending.take(frame)
        full = len(self.window.poses) > self._options.window
        ended = self._pending.release(
            frame.stereo.track, longest=self._longest, oldest=int(self.window.frames[0]) if full else _NEVER
        )
        fused, gated, nis, dof, world_gained = self._fuse(ended)
        if self._lags is not None:
            self._lags.take(frame.k, self._read)
        bias = self.window.layout[TWIST_BIAS]
        return Step(
            pose=self.window.poses[-1].copy(),
            pose_cov=self.window.pose_cov(-1),
            states={
                TWIST_BIAS: State(self.window.nav[bias].copy(), np.sqrt(np.diagonal(self.window.cov)[bias]))
            },
            nis=nis,
            dof=dof,
            used=_of_the_frame(fused, frame),
            gated=_of_the_frame(gated, frame),
            world_gained=gained + world_gained,
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
        """Clone the pose, let the oldest clone go if there are too many, and predict."""
        window = self.window
        if frame.k == 0:
            window.nav = self._motion.first(window.layout, window.nav, frame)
            return
        window.clone()
        clones = len(window.poses) - 1
        if clones > self._options.window:
            self._past.append((window.poses[0].copy(), window.pose_cov(0)))
            window.keep(np.arange(clones) > 0)
        window.predict(self._motion.propagate(window.layout, window.nav, frame), frame.k)

    def _measure(self, frame: Frame) -> Array:
        """Fuse what the model of motion measures; returns what it gained on motions of the world ``(6,)``."""
        window, gained = self.window, np.zeros(6)
        for found in self._motion.measurements(window.layout, window.poses[-1], window.nav, frame):
            jacobian = np.zeros((len(found.innovation), len(window.cov)))
            jacobian[:, : window.layout.size] = found.by_nav
            gained += np.sum((jacobian @ window.directions) ** 2 / found.variance[:, None], axis=0)
            window.correct(jacobian, found.innovation, found.variance)
        return gained

    def _fuse(self, ended: Packed) -> tuple[Packed, Packed, float, int, Array]:
        """Fuse tracks; returns those fused, those gated, NIS, degrees of freedom, and the world's gain."""
        long = ended.length >= self._options.min_length
        tracks = ended.part(long)
        self._counts["tracks_too_short"] += int(np.count_nonzero(~long))
        if not len(tracks):
            return tracks, tracks, 0.0, 0, np.zeros(6)
        constraints = linearise(self._problem.rig, self.window, tracks)
        solved = constraints.solved
        self._counts["tracks_not_triangulated"] += int(np.count_nonzero(~solved))
        tracks, constraints = tracks.part(solved), constraints.part(solved)
        weight = tracks.seen.astype(np.float64)
        projected = eliminate(constraints, weight)
        passes = np.ones(len(tracks), bool)
        if self._gates and len(tracks):
            most = chi2.ppf(self._problem.gate_probability, 3 * tracks.length - 3)
            passes = projected.distances(self.window.cov) <= most
            self._counts["tracks_rejected"] += int(np.count_nonzero(~passes))
        fused, gated = tracks.part(passes), tracks.part(~passes)
        self._fused.append(fused)
        self._gated.append(gated)
        if not len(fused):
            return fused, gated, 0.0, 0, np.zeros(6)
        self._points.update(zip(fused.track.tolist(), constraints.points_world[passes], strict=True))
        if not passes.all():
            constraints = constraints.part(passes)
            projected = eliminate(constraints, weight[passes])
        if self._problem.kernel is not None:
            projected = self._reweighted(constraints, fused)
        jacobian, residual, rest = projected.stacked()
        gained = np.sum((jacobian @ self.window.directions) ** 2, axis=0)
        update = self.window.correct(jacobian, residual, np.ones(len(residual)))
        # Weighted residuals are no chi-square numbers.
        if self._problem.kernel is not None:
            return fused, gated, 0.0, 0, gained
        return fused, gated, update.nis + rest, int(np.sum(3 * fused.length - 3)), gained

    def _reweighted(self, constraints: Constraints, tracks: Packed) -> Projected:
        assert self._problem.kernel is not None
        found, converged = student(self._problem.kernel, constraints, tracks.seen, self.window.cov)
        self._counts["reweightings_not_converged"] += not converged
        return found

    def _read(self, k: int, with_cov: bool) -> tuple[Array, Array | None]:
        """Pose ``(4, 4)`` of a frame as known now, or when it left the window, and its covariance."""
        if k < len(self._past):
            pose, cov = self._past[k]
            return pose, cov if with_cov else None
        place = k - len(self._past)
        return self.window.poses[place].copy(), self.window.pose_cov(place) if with_cov else None


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
