"""Frame-to-frame motion of the camera from its stereo tracks alone, by a robust vote of the tracks.

A track that goes on from one frame to the next is triangulated in the first and measured in the second.
The rigid motion that most tracks agree on is found by iterated reweighting (Geman-McClure weights).
Residuals are taken in (mean column, disparity, row), whose tracking errors are independent, and in units of
a spread that grows with the disparity: a tracker slips by a share of the flow.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.sequence import Sequence
from vislam.geometry import se3, so3
from vislam.models import StereoRig

MIXING = np.array([[0.5, 0.5, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
"""From (uL, uR, v) to (mean column, disparity, row)."""
FEWEST = 6
"""Fewer common tracks than this do not vote."""
_FLOOR_PX = np.array([0.05, 0.05, 0.05])
_SHARE = np.array([0.02, 0.012, 0.02])
"""Spread of a step: floor plus share of the disparity [px]; only its shape matters, the scale is fitted."""
_MEDIAN_CHI3 = 1.538
"""Median of a chi distribution with three degrees of freedom."""
_TUNING = 2.0
_ITERATIONS, _CONVERGED = 12, 1e-6
_BLOCK = 8192
"""Pairs of the frames that are fitted together: as many as arrays of this size stay near the processor."""
_RIDGE, _RELATIVE_RIDGE = 1e-6, 1e-14
_SMALLEST_SCALE = 0.2


@dataclass(frozen=True)
class Continuations:
    """Pairs of observations of one track in successive frames.

    Attributes
    ----------
    before, after : (m,)
        Rows of the sequence; ordered by frame.
    start : (T + 1,)
        Pairs that end in frame k are ``start[k]:start[k + 1]``.
    """

    before: IntArray
    after: IntArray
    start: IntArray


@dataclass(frozen=True)
class RigidFit:
    """Motion between two frames as the tracks see it.

    Attributes
    ----------
    next_T_prev : (4, 4)
        Motion of the left camera.
    residual : (n, 3)
        Of (mean column, disparity, row), in robust standard deviations.
    spread : (n, 3)
        That standard deviation [px].
    cov : (6, 6)
        Covariance of the motion, perturbed on its left.
    """

    next_T_prev: Array
    residual: Array
    spread: Array
    cov: Array


def continuations(sequence: Sequence) -> Continuations:
    """Find all pairs of observations of one track in successive frames."""
    frame = sequence.frame_of
    order = np.lexsort((frame, sequence.track))
    before, after = order[:-1], order[1:]
    follows = (sequence.track[before] == sequence.track[after]) & (frame[after] == frame[before] + 1)
    before, after = before[follows], after[follows]
    by_frame = np.argsort(frame[after], kind="stable")
    before, after = before[by_frame], after[by_frame]
    start = np.searchsorted(frame[after], np.arange(len(sequence) + 1))
    return Continuations(before, after, start)


def inertial_steps(sequence: Sequence) -> Array:
    """Motion ``next_T_prev (T, 4, 4)`` of the body into each frame by the inertial twist."""
    twist, _ = sequence.step_means()
    dt = np.diff(sequence.stamp, prepend=sequence.stamp[0])
    return se3.exp(-twist * dt[:, None])


def predicted_steps(sequence: Sequence) -> Array:
    """Motion ``next_T_prev (T, 4, 4)`` of the left camera into each frame by the inertial twist."""
    return np.asarray(sequence.rig.cam_T_imu @ inertial_steps(sequence) @ sequence.rig.imu_T_cam)


def rigid_fits(sequence: Sequence, pairs: Continuations) -> dict[int, RigidFit]:
    """Fit each frame into which enough tracks continue.

    Parameters
    ----------
    sequence : Sequence
        With disparities above zero; the inertial twist starts each fit.
    pairs : Continuations

    Returns
    -------
    dict of int to RigidFit
        By frame; residuals in the order of the pairs.
    """
    z = sequence.z
    points = sequence.rig.back_project(z)
    spread = step_spread(sequence.disparity)
    guess = predicted_steps(sequence)
    frames = np.flatnonzero(np.diff(pairs.start) >= FEWEST)
    fits = fit_frames(sequence.rig, points, z, pairs=pairs, frames=frames, spread=spread, guess=guess[frames])
    return dict(zip(frames.tolist(), fits, strict=True))


def fit_frames(
    rig: StereoRig,
    points: Array,
    z: Array,
    *,
    pairs: Continuations,
    frames: IntArray,
    spread: Array,
    guess: Array,
) -> list[RigidFit]:
    """Robust fits of the motion into each of some frames, many frames at a time.

    Parameters
    ----------
    rig : StereoRig
    points : (n, 3)
        Of each observation of the sequence, in its camera [m].
    z : (n, 3)
        Measurements of the sequence [px].
    pairs : Continuations
    frames : (F,)
        Ascending; each with at least one pair.
    spread : (n, 3)
        Expected spread of the step from each observation, up to a common factor [px].
    guess : (F, 4, 4)
        Motions to start from.
    """
    count = np.diff(pairs.start)[frames]
    fits: list[RigidFit] = []
    for block in _blocks(count):
        rows = np.concatenate([np.arange(*pairs.start[k : k + 2]) for k in frames[block]])
        old, new = pairs.before[rows], pairs.after[rows]
        votes = _Votes(rig, points[old], z[new], spread[old], count[block])
        fits += votes.fits(guess[block])
    return fits


def fit_rigid(rig: StereoRig, points: Array, z: Array, *, spread: Array, guess: Array) -> RigidFit:
    """Robust fit of the motion that takes points ``(n, 3)`` to measurements ``(n, 3)``.

    Parameters
    ----------
    rig : StereoRig
    points : (n, 3)
        In the camera before [m].
    z : (n, 3)
        Measurements in the camera after [px].
    spread : (n, 3)
        Expected spread up to a common factor [px].
    guess : (4, 4)
        Motion to start from.
    """
    return _Votes(rig, points, z, spread, np.array([len(points)])).fits(guess[None])[0]


def _blocks(count: IntArray) -> list[slice]:
    """Successive frames that have some ``_BLOCK`` pairs together, as slices of the frames."""
    of = np.cumsum(count) // _BLOCK
    ends = [*(np.flatnonzero(np.diff(of)) + 1).tolist(), len(count)]
    return [slice(first, last) for first, last in pairwise([0, *ends]) if last > first]


@dataclass(frozen=True)
class _Votes:
    """Pairs of some frames, those of a frame on end; ``F`` frames, ``n`` pairs.

    Attributes
    ----------
    rig : StereoRig
    points : (n, 3)
        In the camera before [m].
    z : (n, 3)
        Measurements in the camera after [px].
    spread : (n, 3)
        Expected spread up to a factor of the frame [px].
    count : (F,)
        Pairs of each frame, at least one.
    """

    rig: StereoRig
    points: Array
    z: Array
    spread: Array
    count: IntArray

    @cached_property
    def frame(self) -> IntArray:
        """Frame of each pair, ``(n,)``."""
        return np.repeat(np.arange(len(self.count)), self.count)

    @cached_property
    def first(self) -> IntArray:
        """First pair of each frame, ``(F,)``."""
        return np.asarray(np.cumsum(self.count) - self.count)

    def fits(self, guess: Array) -> list[RigidFit]:
        """Fit of each frame from a guess ``(F, 4, 4)``, by iterated reweighting."""
        motion, information = guess.copy(), np.empty((len(guess), 6, 6))
        going, votes = np.arange(len(guess)), self
        for _ in range(_ITERATIONS):
            step, information[going] = votes._step(motion[going])
            motion[going] = se3.exp(step) @ motion[going]
            on = ~(np.abs(step).max(axis=1) < _CONVERGED)
            if not on.all():
                going, votes = going[on], votes._of(on)
            if not len(going):
                break
        residual = self._residual(self._moved(motion))
        scale = self._scale(_square(residual))
        cov = scale[:, None, None] ** 2 * np.linalg.inv(information)
        each = scale[self.frame, None]
        parts = (np.split(part, self.first[1:]) for part in (residual / each, self.spread * each))
        return [RigidFit(*fit) for fit in zip(motion, *parts, cov, strict=True)]

    def _of(self, frames: BoolArray) -> "_Votes":
        """Those of a mask ``(F,)`` of the frames."""
        rows = frames[self.frame]
        return _Votes(self.rig, self.points[rows], self.z[rows], self.spread[rows], self.count[frames])

    def _step(self, motion: Array) -> tuple[Array, Array]:
        """Correction ``(F, 6)`` of motions on their left, and its information ``(F, 6, 6)``."""
        moved = self._moved(motion)
        residual = self._residual(moved)
        square = _square(residual)
        weight = robust_weight(square, self._scale(square)[self.frame])
        by_point = MIXING @ self.rig.projection_jacobian(moved) / self.spread[:, :, None]
        jacobian = np.concatenate([-by_point @ so3.hat(moved), by_point], axis=2)
        weighted = (weight[:, None, None] * jacobian).transpose(0, 2, 1)
        information = np.add.reduceat(weighted @ jacobian, self.first)
        # From a bad guess the points can all come to lie in one direction, which leaves the rest open.
        ridge = _RIDGE + _RELATIVE_RIDGE * np.trace(information, axis1=1, axis2=2)
        information += ridge[:, None, None] * np.eye(6)
        pull = np.add.reduceat(weighted @ residual[:, :, None], self.first)
        return np.linalg.solve(information, pull)[:, :, 0], information

    def _moved(self, motion: Array) -> Array:
        """Points after the motion of their frame, with depths held off zero: a bad guess projects too."""
        pose = motion[self.frame]
        moved = np.einsum("nij,nj->ni", pose[:, :3, :3], self.points) + pose[:, :3, 3]
        moved[:, 2] = np.maximum(moved[:, 2], self.rig.nearest)
        return moved

    def _residual(self, moved: Array) -> Array:
        return np.asarray((self.z - self.rig.project(moved)) @ MIXING.T / self.spread)

    def _scale(self, square: Array) -> Array:
        """Robust standard deviation of each frame, ``(F,)``, from the squared norms of residuals."""
        ordered = square[np.lexsort((square, self.frame))]
        low, high = self.first + (self.count - 1) // 2, self.first + self.count // 2
        return _as_scale(0.5 * (ordered[low] + ordered[high]))


def step_spread(disparity: Array) -> Array:
    """Spread ``(n, 3)`` [px] of (mean column, disparity, row) over a step, up to a common factor."""
    return np.asarray(_FLOOR_PX + _SHARE * disparity[:, None])


def robust_weight(square: Array, scale: float | Array) -> Array:
    """Geman-McClure weights of residuals, from their squared norms."""
    return np.asarray(1.0 / (1.0 + square / (_TUNING * scale) ** 2) ** 2)


def robust_scale(square: Array) -> float:
    """Robust standard deviation of residuals, from their squared norms."""
    return float(_as_scale(float(np.median(square))))


def _as_scale(median_square: Array | float) -> Array:
    """Standard deviation at which residuals have a median of their squared norms."""
    return np.asarray(np.maximum(np.sqrt(median_square) / _MEDIAN_CHI3, _SMALLEST_SCALE))


def _square(residual: Array) -> Array:
    return np.asarray(np.einsum("ni,ni->n", residual, residual))
