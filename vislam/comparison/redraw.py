"""Inertial data re-sampled beside recorded tracks: the reference's motion with a bias and white noise."""

import hashlib
from dataclasses import replace

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.comparison.config import RedrawConfig
from vislam.core.reference import Reference
from vislam.core.sequence import Sequence, piecewise_constant
from vislam.geometry import se3

MARK = "PARTLY SYNTHETIC"
"""How whatever is made with redrawn inertial data begins to say so."""


def redrawn_note(name: str, reference: str) -> str:
    """What a reader must know of redrawn inertial data."""
    return (
        f"{MARK}: the stereo tracks of {name} are recorded; its inertial data are replaced by the motion of "
        f"{reference} with a bias and white noise drawn by the seed"
    )


def redraw(sequence: Sequence, reference: Reference, config: RedrawConfig, *, seed: int) -> Sequence:
    """Replace the inertial data of a repaired sequence, up to the last frame that the reference has.

    Each step has the mean twist that takes the body from one reference pose to the next, a constant bias and
    white noise, independent of other steps', all through it; its clock is the camera's. Where the recording
    has a vertical velocity, it is the reference's with the third noise of the velocity, and the body's own
    vertical velocity stays what the repair makes of it, 0.

    Parameters
    ----------
    sequence : Sequence
        Repaired.
    reference : Reference
        With poses of each of its first frames.
    config : RedrawConfig
    seed : int

    Raises
    ------
    DataError
        If the reference has no poses, or not of successive frames from the first on.
    """
    poses = _body_poses(reference, sequence.name)
    sequence = sequence.first(len(poses))
    period = np.diff(sequence.stamp)[:, None]
    generator = np.random.default_rng(seed)
    bias = np.array(config.bias) + np.array(config.bias_sigma) * generator.standard_normal(6)
    noise = np.array(config.twist_density) / np.sqrt(period) * generator.standard_normal((len(period), 6))
    twist = se3.local(poses[:-1], poses[1:]) / period + bias + noise
    rise = np.full(len(twist), np.nan)
    if np.isfinite(sequence.vertical_velocity).any():
        rise = np.diff(poses[:, 2, 3]) / period[:, 0] + noise[:, 5]
        twist[:, 5] = 0.0
    stamp, samples = piecewise_constant(sequence.stamp, np.column_stack([twist, rise]))
    told = hashlib.sha256(samples.tobytes()).hexdigest()
    return replace(
        sequence,
        name=f"{sequence.name} with redrawn inertial data",
        inertial_stamp=stamp,
        twist=samples[:, :6],
        vertical_velocity=samples[:, 6],
        clock_offset=0.0,
        # Raw inertia would be of another motion than the redrawn.
        imu=None,
        start=None,
        digest=hashlib.sha256(f"{sequence.digest}|{told}".encode()).hexdigest(),
    )


def _body_poses(reference: Reference, name: str) -> Array:
    """Poses ``(m, 4, 4)`` of the body at the first frames."""
    if reference.pose is None or not np.array_equal(reference.frame, np.arange(len(reference.frame))):
        raise DataError(
            "data.redraw_inertial: expected a reference with a pose of every frame from the first on, got "
            f"{reference.name} for {name} ({reference.limits}); leave redraw_inertial out, or name another "
            "reference"
        )
    return np.asarray(reference.pose @ se3.inverse(reference.imu_T_point))
