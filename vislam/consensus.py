"""Cuts tracks where their step does not follow the rigid motion that most tracks agree on.

Moving objects and slipping tracks are consistent with themselves, so a gate on single innovations lets
them through, and they bend the estimate. Between two frames, the tracks vote: a robust fit (Geman-McClure
weights) gives the camera's motion, and a step many deviations off it starts a new track. A track
that never agrees falls to single sightings, which say nothing.
"""

import numpy as np

from vislam.data.sequence import Sequence
from vislam.geometry import se3, so3
from vislam.repair import start_new_tracks
from vislam.sensors import StereoRig
from vislam.types import Array

_MIXING = np.array([[0.5, 0.5, 0.0], [1.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
"""From (uL, uR, v) to (mean column, disparity, row), whose tracking errors are independent."""
_FLOOR_PX = np.array([0.05, 0.05, 0.05])
_SHARE = np.array([0.02, 0.012, 0.02])
"""Spread of a step: floor plus share of the disparity [px]; only its shape matters, the scale is fitted."""
_MEDIAN_CHI3 = 1.538
"""Median of a chi distribution with three degrees of freedom."""
_TUNING = 2.0
_ITERATIONS = 12
_FEWEST = 6
"""Fewer common tracks than this do not vote."""
_NEAREST = 0.5


def cut_inconsistent_tracks(sequence: Sequence, threshold: float) -> Sequence:
    """Start a new track at each observation whose step is off the frame's rigid motion.

    Parameters
    ----------
    sequence : Sequence
        With stale tracks cut; the inertial twist starts each fit.
    threshold : float
        In robust standard deviations of the frame.
    """
    residual = step_residuals(sequence)
    off = np.nan_to_num(np.linalg.norm(residual, axis=1)) > threshold
    return start_new_tracks(sequence, off, inconsistent_cuts=int(off.sum()))


def step_residuals(sequence: Sequence) -> Array:
    """Residual of each observation against its predecessor under the rigid motion of its frame.

    Returns
    -------
    (n, 3)
        Mean column, disparity and row, in robust standard deviations; NaN without a predecessor
        or where too few tracks vote.
    """
    frame, z = sequence.frame_of, sequence.z
    order = np.lexsort((frame, sequence.track))
    before, after = order[:-1], order[1:]
    follows = (sequence.track[before] == sequence.track[after]) & (frame[after] == frame[before] + 1)
    before, after = before[follows], after[follows]
    by_frame = np.argsort(frame[after], kind="stable")
    before, after = before[by_frame], after[by_frame]
    start = np.searchsorted(frame[after], np.arange(len(sequence) + 1))

    points = sequence.rig.back_project(z)
    spread = _FLOOR_PX + _SHARE * (z[:, 0] - z[:, 1])[:, None]
    twist, _ = sequence.step_means()
    dt = np.diff(sequence.stamp, prepend=sequence.stamp[0])
    predicted = sequence.rig.cam_T_imu @ se3.exp(-twist * dt[:, None]) @ sequence.rig.imu_T_cam
    out = np.full((sequence.observations, 3), np.nan)
    for k in np.flatnonzero(np.diff(start) >= _FEWEST):
        old, new = before[start[k] : start[k + 1]], after[start[k] : start[k + 1]]
        out[new] = _rigid_residuals(sequence.rig, points[old], z[new], spread=spread[old], guess=predicted[k])
    return out


def _rigid_residuals(rig: StereoRig, points: Array, z: Array, *, spread: Array, guess: Array) -> Array:
    """Residuals ``(n, 3)`` after a robust fit of the motion ``next_T_previous`` of the camera."""
    motion = guess
    for _ in range(_ITERATIONS):
        moved = _in_front(se3.transform(motion, points))
        residual = (z - rig.project(moved)) @ _MIXING.T / spread
        jacobian = rig.projection_jacobian(moved)
        jacobian = np.concatenate([-jacobian @ so3.hat(moved), jacobian], axis=2)
        jacobian = _MIXING @ jacobian / spread[:, :, None]
        square = np.einsum("ni,ni->n", residual, residual)
        weight = 1.0 / (1.0 + square / (_TUNING * _scale(square)) ** 2) ** 2
        weighted = (weight[:, None, None] * jacobian).reshape(-1, 6)
        information = weighted.T @ jacobian.reshape(-1, 6) + 1e-6 * np.eye(6)
        step = np.linalg.solve(information, weighted.T @ residual.reshape(-1))
        motion = se3.exp(step) @ motion
        if np.abs(step).max() < 1e-6:
            break
    moved = _in_front(se3.transform(motion, points))
    residual = (z - rig.project(moved)) @ _MIXING.T / spread
    return np.asarray(residual / _scale(np.einsum("ni,ni->n", residual, residual)))


def _scale(square: Array) -> float:
    """Robust standard deviation of residuals, from their squared norms."""
    return max(float(np.sqrt(np.median(square))) / _MEDIAN_CHI3, 0.2)


def _in_front(points_cam: Array) -> Array:
    """Points with their depth held off zero, so that a bad guess projects somewhere."""
    return np.column_stack([points_cam[:, :2], np.maximum(points_cam[:, 2], _NEAREST)])
