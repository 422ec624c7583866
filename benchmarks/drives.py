"""Simulated drives on which the filter's model is exactly true: only its linearisation can be wrong.

The simulator's inertial samples are joined by straight lines, which leaves half of a sample's noise to the
step before and half to the step after; the filters take the noise of steps for independent. Here each step
has a twist of its own, the true one plus the bias plus independent noise. Bias and first pose are drawn from
their priors. Nothing is chosen by its noise: no repair, no gate, no track that starts so far away that its
disparity could come out as none.
"""

from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array
from vislam.core.estimator import Problem
from vislam.core.sequence import Sequence, piecewise_constant
from vislam.geometry import se3
from vislam.models import TrackNoise
from vislam.models.odometry import MotionNoise
from vislam.simulation import SimulationConfig, simulate

_PERIOD = 0.1
_SPEED = 10.0
_TRACKS = 30.0
_FARTHEST = 60.0
"""Farthest depth of a track's start [m]: a disparity of 5.5 px."""
_GATE = 0.99
"""Not looked at: the filters' gates are off."""


@dataclass(frozen=True)
class Level:
    """Levels of the noise.

    Attributes
    ----------
    pixel_sigma : float
        White noise of a pixel coordinate [px].
    twist_density : (6,)
        White noise of the twist (omega, v) [rad/sqrt(s), m/sqrt(s)].
    bias_sigma : (6,)
        Prior of its bias [rad/s, m/s].
    first_pose_sigma : (6,)
        Prior of the first pose [rad, m].
    """

    pixel_sigma: float
    twist_density: tuple[float, ...]
    bias_sigma: tuple[float, ...]
    first_pose_sigma: tuple[float, ...] = (1e-4,) * 6


_BIAS_SIGMA = (0.02, 0.02, 0.02, 0.01, 0.05, 0.02)
LEVELS = {
    # Twist and bias as in the configs of these names; white noise in place of all their pixel errors.
    "kitti07": Level(0.5, (0.016, 0.016, 0.016, 0.16, 0.12, 0.02), _BIAS_SIGMA),
    "ds3": Level(0.5, (0.0038, 0.0040, 0.0032, 0.0034, 0.055, 0.033), _BIAS_SIGMA),
    "small": Level(0.1, (0.001, 0.001, 0.001, 0.02, 0.02, 0.02), (0.002, 0.002, 0.002, 0.01, 0.01, 0.01)),
}
"""The levels that are measured."""


def drive(level: Level, *, frames: int, seed: int) -> tuple[Sequence, Problem, Array]:
    """Simulate a drive once round a circle, which is the smaller the fewer frames there are.

    Returns
    -------
    Sequence
    Problem
        With the noise and the priors that the drive has.
    truth : (T, 4, 4)
        True poses in the world of the estimators, whose first pose is the identity.
    """
    config = SimulationConfig(
        frames=frames,
        period=_PERIOD,
        path="loop",
        speed=_SPEED,
        tracks_in_view=_TRACKS,
        depth_max=_FARTHEST,
        pixel_sigma_px=level.pixel_sigma,
        gyro_sigma=0.0,
        velocity_sigma=0.0,
    )
    raw, true = simulate(config, seed=seed, name=f"drive {seed}")
    generator = np.random.default_rng([seed, 1])
    density, bias_sigma = np.array(level.twist_density), np.array(level.bias_sigma)
    first_pose_sigma = np.array(level.first_pose_sigma)
    bias = bias_sigma * generator.standard_normal(6)
    noise = density / np.sqrt(_PERIOD) * generator.standard_normal((frames - 1, 6))
    twist = se3.local(true.world_T_imu[:-1], true.world_T_imu[1:]) / _PERIOD + bias + noise
    inertial_stamp, samples = piecewise_constant(raw.stamp, twist)
    sequence = replace(
        raw,
        inertial_stamp=inertial_stamp,
        twist=samples,
        climb_rate=np.full(len(inertial_stamp), np.nan),
    )
    problem = Problem(
        rig=raw.rig,
        noise=MotionNoise(density, np.zeros(6)),
        first_pose_sigma=first_pose_sigma,
        bias_mean=np.zeros(6),
        bias_sigma=bias_sigma,
        track_noise=TrackNoise(level.pixel_sigma, 0.0, 0.0),
        gate_probability=_GATE,
    )
    first = se3.exp(first_pose_sigma * generator.standard_normal(6))
    return sequence, problem, first @ se3.inverse(true.world_T_imu[0]) @ true.world_T_imu
