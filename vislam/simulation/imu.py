"""Raw inertia of a simulated drive: what accelerometer and gyro of the body measure, and a first guess."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.core.imu import ImuSeries
from vislam.geometry import so3
from vislam.models.imu import IMU_NAV, ImuPrior
from vislam.simulation.path import BodyPath
from vislam.simulation.settings import ImuSimulation

_HALF = 2e-3
"""Half the time over which derivatives of the path are taken [s]."""
_MARGIN = 0.05
"""Samples before the first frame and after the last [s]."""


@dataclass(frozen=True)
class ImuTruth:
    """True states beside the pose at each frame.

    Attributes
    ----------
    velocity : (T, 3)
        In the world [m/s].
    gyro_bias, accel_bias : (T, 3)
        [rad/s], [m/s^2].
    """

    velocity: Array
    gyro_bias: Array
    accel_bias: Array


def derivatives(path: BodyPath, time: Array) -> tuple[Array, Array, Array, Array]:
    """Pose ``(n, 4, 4)``, rate ``(n, 3)`` in the body, velocity and acceleration ``(n, 3)`` in the world.

    By central differences of fourth order over five poses, a few milliseconds apart.
    """
    near = [path.pose(time + shift * _HALF) for shift in (-2, -1, 0, 1, 2)]
    p = [pose[:, :3, 3] for pose in near]
    velocity = (p[0] - 8.0 * p[1] + 8.0 * p[3] - p[4]) / (12.0 * _HALF)
    acceleration = (-p[0] + 16.0 * p[1] - 30.0 * p[2] + 16.0 * p[3] - p[4]) / (12.0 * _HALF**2)
    turns = [so3.log(near[2][:, :3, :3].transpose(0, 2, 1) @ pose[:, :3, :3]) for pose in near]
    rate = (turns[0] - 8.0 * turns[1] + 8.0 * turns[3] - turns[4]) / (12.0 * _HALF)
    return near[2], rate, velocity, acceleration


def simulate_imu(
    config: ImuSimulation,
    path: BodyPath,
    stamp: Array,
    *,
    clock_offset: float,
    generator: np.random.Generator,
) -> tuple[ImuSeries, ImuTruth]:
    """Samples over all frames, and the true states at these.

    Parameters
    ----------
    config : ImuSimulation
    path : BodyPath
    stamp : (T,)
        Camera times [s].
    clock_offset : float
        How late the stamps of the samples are against the camera's [s].
    generator : Generator
    """
    period = 1.0 / config.rate
    time = np.arange(stamp[0] - _MARGIN, stamp[-1] + _MARGIN, period) + period * generator.uniform()
    pose, rate, _, acceleration = derivatives(path, time)
    up = np.array([0.0, 0.0, config.gravity])
    force = (pose[:, :3, :3].transpose(0, 2, 1) @ (acceleration + up)[:, :, None])[:, :, 0]
    bias = _bias(config, len(time), period, generator)
    white = np.repeat([config.gyro_density, config.accel_density], 3) / np.sqrt(period)
    noise = white * generator.standard_normal((len(time), 6)) + _vibration(config, time, generator)
    samples = np.hstack([rate, force]) + bias + noise
    at_frames = np.column_stack([np.interp(stamp, time, column) for column in bias.T])
    velocity = derivatives(path, stamp)[2]
    series = ImuSeries(time + clock_offset, samples[:, :3], samples[:, 3:])
    return series, ImuTruth(velocity, at_frames[:, :3], at_frames[:, 3:])


def first_guess(
    config: ImuSimulation, world_T_imu: Array, truth: ImuTruth, generator: np.random.Generator
) -> ImuPrior:
    """Prior of the first state: the true one ``(4, 4)`` less an error drawn from its covariance.

    Heading and position are free to be chosen, and are those of the truth; the biases are taken for zero,
    from which they were drawn.
    """
    tilt = config.tilt_sigma * generator.standard_normal(2)
    turn = so3.exp(np.array([*tilt, 0.0]))
    pose = world_T_imu.copy()
    # Truth = turn estimate, in the world's axes.
    pose[:3, :3] = turn.T @ world_T_imu[:3, :3]
    velocity = truth.velocity[0] - config.velocity_sigma * generator.standard_normal(3)
    by_world = pose[:3, :3].T
    cov = np.zeros((IMU_NAV, IMU_NAV))
    in_world = np.diag([config.tilt_sigma**2, config.tilt_sigma**2, config.gauge_sigma**2])
    cov[:3, :3] = by_world @ in_world @ by_world.T
    cov[3:6, 3:6] = config.gauge_sigma**2 * np.eye(3)
    cov[6:9, 6:9] = config.velocity_sigma**2 * np.eye(3)
    cov[9:12, 9:12] = config.gyro_bias_sigma**2 * np.eye(3)
    cov[12:, 12:] = config.accel_bias_sigma**2 * np.eye(3)
    how = "the true state with an error drawn from its covariance (simulated)"
    return ImuPrior(pose, velocity, np.zeros(3), np.zeros(3), cov, how)


def _bias(config: ImuSimulation, count: int, period: float, generator: np.random.Generator) -> Array:
    """Bias ``(n, 6)`` of gyro and accelerometer: drawn once, then walking."""
    first = np.repeat([config.gyro_bias_sigma, config.accel_bias_sigma], 3) * generator.standard_normal(6)
    walk = np.sqrt(period) * np.repeat([config.gyro_walk, config.accel_walk], 3)
    steps = walk * generator.standard_normal((count, 6))
    return np.asarray(first + np.cumsum(steps, axis=0))


def _vibration(config: ImuSimulation, time: Array, generator: np.random.Generator) -> Array:
    """Shaking ``(n, 6)`` by an engine whose phase wanders, that moves the body by next to nothing."""
    size = np.repeat([config.vibration_gyro, config.vibration_accel], 3)
    first = generator.uniform(0.0, 2.0 * np.pi, 6)
    wander = np.cumsum(generator.standard_normal(len(time))) * np.sqrt(time[1] - time[0])
    phase = 2.0 * np.pi * config.vibration_hz * time + wander
    return np.asarray(np.sqrt(2.0) * size * np.sin(phase[:, None] + first))


def in_world_of(start: Array, truth: ImuTruth) -> ImuTruth:
    """The same in a world that a pose ``(4, 4)`` takes the path's world to."""
    return ImuTruth(truth.velocity @ start[:3, :3].T, truth.gyro_bias, truth.accel_bias)
