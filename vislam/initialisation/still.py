"""A body at rest at the first frame: gravity's direction and the gyro bias from the mean of the samples.

At rest ``gyro = b_g + n`` and ``accel = R^T (0, 0, gravity) + b_a + n``: tilt and accelerometer bias cannot
be told apart but by a prior of the latter, which is why they come out correlated.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.core.sequence import Sequence
from vislam.geometry import so3
from vislam.initialisation.found import SIZE, Found, bias_prior
from vislam.initialisation.settings import InitialisationSettings
from vislam.initialisation.window import Window
from vislam.models.imu import ImuNoise

_FEWEST_TRACKS = 6
_BLOCK = 0.1
"""Samples of so long are averaged before their spread is taken: shaking is correlated [s]."""


@dataclass(frozen=True)
class Still:
    """A standstill from the first frame on.

    Attributes
    ----------
    length : float
        [s].
    velocity_sigma : float
        How slowly it may move for all the tracks say [m/s].
    """

    length: float
    velocity_sigma: float


def standstill(
    sequence: Sequence, window: Window, noise: ImuNoise, settings: InitialisationSettings
) -> Still:
    """The longest standstill from the first frame on, by the tracks and by the spread of the samples."""
    first = slice(sequence.offset[0], sequence.offset[1])
    focal = 0.5 * (sequence.rig.fx + sequence.rig.fy)
    steps, depth = 0, np.nan
    for k in range(1, len(window) + 1):
        frame = window.frame[k]
        rows = slice(sequence.offset[frame], sequence.offset[frame + 1])
        _, before, after = np.intersect1d(sequence.track[first], sequence.track[rows], return_indices=True)
        if len(before) < _FEWEST_TRACKS or not _quiet(window.first(k), noise, settings):
            break
        moved = sequence.z[rows][after] - sequence.z[first][before]
        if np.median(np.linalg.norm(moved[:, [0, 2]], axis=1)) > settings.still_px:
            break
        disparity = np.median(sequence.disparity[first][before])
        steps, depth = k, focal * sequence.rig.baseline / max(float(disparity), 1.0)
    length = float(window.stamp[steps] - window.stamp[0])
    return Still(length, settings.still_px * depth / focal / length if steps else np.nan)


def at_rest(window: Window, still: Still, noise: ImuNoise, settings: InitialisationSettings) -> Found:
    """State of a body at rest over a window."""
    gyro, gyro_cov = _mean(window, "gyro", noise.gyro_density, noise.gyro_walk)
    accel, accel_cov = _mean(window, "accel", noise.accel_density, noise.accel_walk)
    turn = so3.onto(accel, np.array([0.0, 0.0, 1.0]))
    # In the body: accel = turn^T exp(-tilt) gravity z + b_a, and b_a is 0 a priori.
    prior = bias_prior(settings)
    upward = noise.gravity * turn.T
    design = np.zeros((3, SIZE))
    design[:, :2] = (upward @ so3.hat(np.array([0.0, 0.0, 1.0])))[:, :2]
    design[:, 8:] = np.eye(3)
    information = design.T @ np.linalg.solve(accel_cov, design)
    information[5:8, 5:8] += np.linalg.inv(gyro_cov)
    information[2:5, 2:5] += np.eye(3) / still.velocity_sigma**2
    residual = accel - upward[:, 2]
    right = design.T @ np.linalg.solve(accel_cov, residual)
    right[5:8] += np.linalg.solve(gyro_cov, gyro)
    error = np.asarray(np.linalg.solve(information + prior, right), float)
    return Found(
        "static",
        so3.exp(np.array([*error[:2], 0.0])) @ turn,
        np.zeros(3),
        error[5:8],
        error[8:],
        information,
        prior,
    )


def _quiet(window: Window, noise: ImuNoise, settings: InitialisationSettings) -> bool:
    """Whether the samples of a window spread no more than those of a body at rest."""
    for name, density in (("gyro", noise.gyro_density), ("accel", noise.accel_density)):
        samples = np.concatenate([getattr(step, name)[:-1] for step in window.inertia])
        usual = window.length / max(len(samples), 1)
        if samples.std(axis=0).max() > settings.still_noise * density / np.sqrt(usual):
            return False
    return True


def _mean(window: Window, name: str, density: float, walk: float) -> tuple[Array, Array]:
    """Mean ``(3,)`` of samples and its covariance ``(3, 3)``: stated or by their spread, whichever is more.

    With the walk of the bias since the first frame.
    """
    parts = [(step.dt, getattr(step, f"mean_{name}")) for step in window.inertia]
    dt, values = np.concatenate([one for one, _ in parts]), np.concatenate([many for _, many in parts])
    mean = np.average(values, axis=0, weights=dt)
    block = (np.cumsum(dt) / _BLOCK).astype(int)
    length = np.bincount(block, weights=dt)
    sums = np.column_stack([np.bincount(block, weights=dt * axis) for axis in values.T])
    blocks = sums[length > 0.0] / length[length > 0.0, None]
    by_spread = blocks.var(axis=0, ddof=1) / len(blocks) if len(blocks) > 1 else np.zeros(3)
    stated = density**2 / dt.sum() + walk**2 * dt.sum() / 3.0
    return mean, np.diag(np.maximum(by_spread, stated))
