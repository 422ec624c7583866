"""Frame-to-frame motion of the camera from its stereo tracks alone, by a robust vote of the tracks.

A track that goes on from one frame to the next is triangulated in the first and measured in the second.
The rigid motion that most tracks agree on is found by iterated reweighting (Geman-McClure weights).
Residuals are taken in (mean column, disparity, row), whose tracking errors are independent, and in units of
a spread that grows with the disparity: a tracker slips by a share of the flow.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
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
_ITERATIONS = 12
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
    fits = {}
    for k in np.flatnonzero(np.diff(pairs.start) >= FEWEST):
        rows = slice(pairs.start[k], pairs.start[k + 1])
        old, new = pairs.before[rows], pairs.after[rows]
        fits[int(k)] = fit_rigid(sequence.rig, points[old], z[new], spread=spread[old], guess=guess[k])
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
    motion = guess
    for _ in range(_ITERATIONS):
        moved = _in_front(se3.transform(motion, points), rig.nearest)
        residual = (z - rig.project(moved)) @ MIXING.T / spread
        jacobian = rig.projection_jacobian(moved)
        jacobian = np.concatenate([-jacobian @ so3.hat(moved), jacobian], axis=2)
        jacobian = MIXING @ jacobian / spread[:, :, None]
        square = np.einsum("ni,ni->n", residual, residual)
        scale = robust_scale(square)
        weight = robust_weight(square, scale)
        weighted = (weight[:, None, None] * jacobian).reshape(-1, 6)
        information = weighted.T @ jacobian.reshape(-1, 6)
        # From a bad guess the points can all come to lie in one direction, which leaves the rest open.
        information += (_RIDGE + _RELATIVE_RIDGE * np.trace(information)) * np.eye(6)
        step = np.linalg.solve(information, weighted.T @ residual.reshape(-1))
        motion = se3.exp(step) @ motion
        if np.abs(step).max() < 1e-6:
            break
    moved = _in_front(se3.transform(motion, points), rig.nearest)
    residual = (z - rig.project(moved)) @ MIXING.T / spread
    scale = robust_scale(np.einsum("ni,ni->n", residual, residual))
    cov = np.asarray(scale**2 * np.linalg.inv(information))
    return RigidFit(motion, residual / scale, spread * scale, cov)


def step_spread(disparity: Array) -> Array:
    """Spread ``(n, 3)`` [px] of (mean column, disparity, row) over a step, up to a common factor."""
    return np.asarray(_FLOOR_PX + _SHARE * disparity[:, None])


def robust_weight(square: Array, scale: float) -> Array:
    """Geman-McClure weights of residuals, from their squared norms."""
    return np.asarray(1.0 / (1.0 + square / (_TUNING * scale) ** 2) ** 2)


def robust_scale(square: Array) -> float:
    """Robust standard deviation of residuals, from their squared norms."""
    return max(float(np.sqrt(np.median(square))) / _MEDIAN_CHI3, _SMALLEST_SCALE)


def _in_front(points_cam: Array, nearest: float) -> Array:
    """Points with their depth held off zero, so that a bad guess projects somewhere."""
    return np.column_stack([points_cam[:, :2], np.maximum(points_cam[:, 2], nearest)])
