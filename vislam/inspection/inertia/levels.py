"""Gravity and the biases of raw inertia, against the camera's motion."""

import numpy as np

from vislam.base.types import Array
from vislam.inspection.finding import Finding, Measured, robust_mean
from vislam.inspection.inertia.forces import Fall
from vislam.inspection.inertia.turns import Turns

_OFF, _SURE = 0.02, 4.0
"""Gravity is another if it is off by this share, and by so many standard deviations; the scale of the
accelerometer is in it."""
_UNCLEAR = 0.1
"""Standard deviation of gravity, as a share of it, above which nothing is told."""
_BEYOND = 3.0
"""Standard deviations of the prior within which a bias may lie."""
_AXES = "xyz"


def check_gravity(found: Fall, *, configured: float) -> Finding:
    """Magnitude of gravity by the accelerometer, what the camera sees of the acceleration taken off.

    Parameters
    ----------
    found : Fall
    configured : float
        ``noise.imu.gravity`` [m/s^2].
    """
    value, sigma = found.magnitude
    measured = Measured.around("gravity", "m/s^2", value, sigma=sigma)
    text = f"{measured}, configured is {configured:g}"
    if sigma > _UNCLEAR * configured:
        unknown = {"noise.imu.gravity": f"{text}; as configured"}
        return Finding("imu gravity", "unclear", f"not told: {text}", (measured,), unknown=unknown)
    off = abs(value - configured)
    if off > _OFF * configured and off > _SURE * sigma:
        text = f"{text}: look at the scale of the accelerometer, at the baseline and at the configured value"
        proposal = {"noise.imu.gravity": float(f"{value:.4g}")}
        return Finding("imu gravity", "fault", text, (measured,), proposal=proposal)
    return Finding("imu gravity", "ok", text, (measured,))


def check_biases(
    turns: Turns,
    found: Fall,
    cam_R_imu: Array,
    *,
    offset: float,
    sigma: tuple[float, float],
) -> Finding:
    """Biases of gyro and accelerometer against the prior that an initialisation takes.

    Parameters
    ----------
    turns : Turns
    found : Fall
    cam_R_imu : (3, 3)
    offset : float
        How late the stamps of the samples are [s].
    sigma : (float, float)
        Of that prior, gyro and accelerometer [rad/s, m/s^2].
    """
    off = turns.measured(offset) - turns.seen @ cam_R_imu
    gyro = [robust_mean(off[:, i], name=f"gyro bias {_AXES[i]}", unit="rad/s") for i in range(3)]
    bias = cam_R_imu.T @ found.bias
    spread = np.sqrt(np.diagonal(cam_R_imu.T @ found.cov[:3, :3] @ cam_R_imu))
    accel = [
        Measured.around(f"accelerometer bias {_AXES[i]}", "m/s^2", float(bias[i]), sigma=float(spread[i]))
        for i in range(3)
    ]
    every, prior = [*gyro, *accel], np.repeat(sigma, 3)
    text = "; ".join(str(one) for one in every)
    beyond = [
        one.name
        for one, wide in zip(every, prior, strict=True)
        if abs(one.value) - 1.96 * one.sigma > _BEYOND * wide
    ]
    if beyond:
        text = (
            f"{', '.join(beyond)} beyond {_BEYOND:g} standard deviations of what a first state is searched "
            f"with ({sigma[0]:g} rad/s, {sigma[1]:g} m/s^2), calibrate the sensor: {text}"
        )
        return Finding("imu biases", "fault", text, tuple(every), unknown={"data.file": f"biases: {text}"})
    loose = [one.name for one in accel if one.sigma > 0.5 * sigma[1]]
    if loose:
        text = f"{text}; {', '.join(loose)} not told from gravity by so little turning"
    return Finding("imu biases", "ok", text, tuple(every))
