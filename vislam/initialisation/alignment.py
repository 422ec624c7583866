"""Velocity, gravity and gyro bias of a body that moves, by linear least squares over the first frames.

With the poses ``(R_k, p_k)`` that stereo tracks give in the frame of the first, scale included, all that
inertia adds is linear (Qin, Li and Shen, *VINS-Mono*, TRO 34 (2018), section V-B, without the unknown scale):
the bias of the gyro from the turns,

    log(exp(-theta_k) R_k^T R_{k+1}) = theta_b b_g,

and with it the first velocity and gravity, of any magnitude, from the positions,

    p_k - s_k = v_0 t_k + g t_k^2 / 2,

``s_k`` being what the specific forces alone come to, integrated twice along the attitudes.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.geometry import so3
from vislam.initialisation.window import Window
from vislam.models.imu import ImuNoise


@dataclass(frozen=True)
class Aligned:
    """First guess, in the frame of the first pose.

    Attributes
    ----------
    gyro_bias : (3,)
        [rad/s].
    velocity, gravity : (3,)
        [m/s], [m/s^2].
    gravity_sigma : float
        Standard deviation of the magnitude of gravity by the residuals [m/s^2].
    """

    gyro_bias: Array
    velocity: Array
    gravity: Array
    gravity_sigma: float


def align(window: Window, noise: ImuNoise) -> Aligned:
    """Align what inertia and tracks say of a window, which has four steps or more."""
    bias = _gyro_bias(window, noise)
    steps = window.preintegrated(noise, bias, np.zeros(3))
    poses = window.poses()
    velocity, place = np.zeros(3), np.zeros(3)
    known = np.zeros((len(window) + 1, 3))
    for k, step in enumerate(steps):
        turn = poses[k, :3, :3]
        place = place + velocity * step.time + turn @ step.position
        velocity = velocity + turn @ step.velocity
        known[k + 1] = place
    time = window.stamp - window.stamp[0]
    design = np.column_stack([time, 0.5 * time**2])[1:]
    wanted = (poses[:, :3, 3] - known)[1:]
    solution, *_ = np.linalg.lstsq(design, wanted, rcond=None)
    residual = wanted - design @ solution
    spread = np.sqrt(np.sum(residual**2) / max(3 * (len(wanted) - 2), 1))
    sigma = spread * np.sqrt(np.linalg.inv(design.T @ design)[1, 1])
    return Aligned(bias, solution[0], solution[1], float(sigma))


def gyro_slope(window: Window) -> tuple[float, float]:
    """Turns of the gyro by those of the tracks: the slope, and the correlation of the two.

    Both less their means, over steps that the tracks tell. Those of the gyro are means of its rates: rates in
    degrees, taken for radians, come round within a step.
    """
    gyro = np.array([step.dt @ step.mean_gyro / step.dt.sum() for step in window.inertia])[window.told]
    time = np.diff(window.stamp)[window.told, None]
    seen = so3.log(window.motion[window.told][:, :3, :3]) / time
    gyro, seen = gyro - gyro.mean(axis=0), seen - seen.mean(axis=0)
    both, own, other = np.sum(gyro * seen), np.sum(gyro**2), np.sum(seen**2)
    return float(both / max(other, 1e-12)), float(both / max(np.sqrt(own * other), 1e-12))


def _gyro_bias(window: Window, noise: ImuNoise) -> Array:
    """Bias ``(3,)`` by which the turns of the gyro become those of the tracks [rad/s], in two steps."""
    bias = np.zeros(3)
    for _ in range(2):
        steps = window.preintegrated(noise, bias, np.zeros(3))
        normal, right = np.zeros((3, 3)), np.zeros(3)
        for step, seen, told in zip(steps, window.motion, window.told, strict=True):
            if told:
                by_bias = step.by_bias[:3, :3]
                normal += by_bias.T @ by_bias
                right += by_bias.T @ so3.log(step.rotation.T @ seen[:3, :3])
        bias = bias + np.linalg.solve(normal, right)
    return bias
