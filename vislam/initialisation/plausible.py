"""Units and axes of raw inertia, by what gravity and the tracks say of them."""

import numpy as np

from vislam.initialisation.alignment import Aligned, gyro_slope
from vislam.initialisation.found import NotFoundError
from vislam.initialisation.window import Window
from vislam.models.imu import FORCE_UNITS, RATE_UNITS, ImuNoise

_NEAR = 1.5
"""A factor is that of a unit up to so much."""
_POSSIBLE = 2.0
"""A median force is that of gravity up to this factor."""
_TURNS = 0.02
"""Spread of the rates, by the tracks or by the gyro, that tells the gyro's unit [rad/s]."""
_MAGNITUDE, _SURE = 0.1, 5.0
"""Gravity is another if it is off by this share and by so many standard deviations."""


def check_force(window: Window, noise: ImuNoise) -> None:
    """Raise NotFoundError if the specific force is not in m/s^2."""
    force = np.concatenate([step.mean_accel for step in window.inertia])
    median = float(np.median(np.linalg.norm(force, axis=1)))
    ratio = median / noise.gravity
    if 1.0 / _POSSIBLE < ratio < _POSSIBLE:
        return
    # The magnitude does not tell cm/s^2 from mg, which differ by 2 %.
    units = {name: f"{size:.4g}" for name, size in FORCE_UNITS.items() if 1.0 / _NEAR < ratio / size < _NEAR}
    guess = (
        f"it looks like {' or '.join(units)}, divide by {' or '.join(units.values())}, or set "
        "data.repair.imu_units.accel"
    )
    guess = guess if units else "look at its unit"
    raise NotFoundError(
        f"the accelerometer must show gravity, {noise.gravity:.2f} m/s^2, got {median:.3g} (median of its "
        f"magnitude): {guess}"
    )


def check_turns(window: Window) -> None:
    """Raise NotFoundError if gyro and tracks turn by other angles, or about other axes."""
    slope, correlation = gyro_slope(window)
    time = np.diff(window.stamp)[window.told, None, None]
    rates = (window.motion[window.told][:, :3, :3] - np.eye(3)) / time
    own = np.array([step.gyro.mean(axis=0) for step in window.inertia])
    if max(float(rates.std(axis=0).max()), float(own.std(axis=0).max())) < _TURNS:
        return
    if correlation > 0.5 and 1.0 / _NEAR < slope / RATE_UNITS["deg/s"] < _NEAR:
        raise NotFoundError(
            f"the gyro must be in rad/s, got {slope:.3g} times the turns of the tracks: it looks like "
            "deg/s, set data.repair.imu_units.gyro"
        )
    if correlation < 0.5:
        raise NotFoundError(
            f"gyro and tracks must turn about the same axes, got a correlation of {correlation:.2f}: look at "
            "imu_T_cam, at the axes of the gyro and at its clock"
        )


def check_gravity(aligned: Aligned, noise: ImuNoise) -> None:
    """Raise NotFoundError if gravity, by inertia and tracks together, has another magnitude."""
    found = float(np.linalg.norm(aligned.gravity))
    off = abs(found - noise.gravity)
    if off > _MAGNITUDE * noise.gravity and off > _SURE * aligned.gravity_sigma:
        raise NotFoundError(
            f"gravity must come out as {noise.gravity:.2f} m/s^2, got {found:.2f} +- "
            f"{aligned.gravity_sigma:.2f} by inertia and tracks: look at the unit of the accelerometer, at "
            "the baseline, at imu_T_cam and at the clock"
        )
