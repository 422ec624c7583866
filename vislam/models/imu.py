"""An accelerometer and a gyro: how noisy they are, and what is known of the state that they start from.

A gyro measures the angular velocity of the body, an accelerometer its acceleration less that of gravity, both
along the body's axes and each with a bias b that walks:

    gyro = omega + b_g + n_g,    accel = R^T (a_world - g_world) + b_a + n_a,    g_world = (0, 0, -gravity),

R being the attitude ``world_R_imu`` in a world whose z axis points up. The noises n are white, of the stated
density: a sample that stands for dt has the standard deviation ``density / sqrt(dt)``; the walks change a
bias by ``walk sqrt(dt)``. These are the units of data sheets, and of Kalibr and OpenVINS.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array

GRAVITY = 9.80665
"""Standard gravity [m/s^2]."""
RATE_UNITS = {
    "rad/s": 1.0,
    "deg/s": 180.0 / np.pi,
    "mrad/s": 1000.0,
    "mdeg/s": 180e3 / np.pi,
    "rpm": 30.0 / np.pi,
}
FORCE_UNITS = {"m/s^2": 1.0, "g": 1.0 / GRAVITY, "cm/s^2": 100.0, "mg": 1000.0 / GRAVITY, "mm/s^2": 1000.0}
"""What 1 rad/s and 1 m/s^2 are in the units that gyros and accelerometers are read in."""
VELOCITY, GYRO_BIAS, ACCEL_BIAS = "velocity", "gyro_bias", "accel_bias"
"""Names of the states ``(3,)`` beside the pose: in the world [m/s], of the gyro [rad/s] and of the
accelerometer [m/s^2]."""
STATES = (VELOCITY, GYRO_BIAS, ACCEL_BIAS)
"""Their order in a prior."""
IMU_NAV = 15
"""Size of the error (pose, velocity, gyro bias, accelerometer bias)."""


@dataclass(frozen=True)
class ImuNoise:
    """Noise of an inertial measurement unit in continuous time, the same along all axes.

    Attributes
    ----------
    gyro_density : float
        White noise of the angular velocity [rad/s/sqrt(Hz)].
    accel_density : float
        White noise of the specific force [m/s^2/sqrt(Hz)].
    gyro_walk : float
        Random walk of the gyro's bias [rad/s/sqrt(s)], in data sheets also [rad/s^2/sqrt(Hz)].
    accel_walk : float
        Random walk of the accelerometer's bias [m/s^2/sqrt(s)], also [m/s^3/sqrt(Hz)].
    gravity : float
        Magnitude of gravity [m/s^2].

    Raises
    ------
    ValueError
        If a density is not above 0, a walk is negative, or gravity is not above 0.
    """

    gyro_density: float
    accel_density: float
    gyro_walk: float
    accel_walk: float
    gravity: float = GRAVITY

    def __post_init__(self) -> None:
        """Reject what is no noise."""
        for name in ("gyro_density", "accel_density", "gravity"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"{name} must be > 0, got {getattr(self, name):g}")
        for name in ("gyro_walk", "accel_walk"):
            if not getattr(self, name) >= 0.0:
                raise ValueError(f"{name} must be >= 0, got {getattr(self, name):g}")

    @property
    def gravity_world(self) -> Array:
        """Gravity ``(3,)`` in a world whose z axis points up [m/s^2]."""
        return np.array([0.0, 0.0, -self.gravity])


@dataclass(frozen=True)
class ImuPrior:
    """What is known of the state at the first frame, the same for every estimator.

    Attributes
    ----------
    world_T_imu : (4, 4)
        Pose in a world whose z axis points up. Its roll and pitch are where gravity enters; heading and
        position are free to be chosen.
    velocity : (3,)
        In the world [m/s].
    gyro_bias, accel_bias : (3,)
        [rad/s], [m/s^2].
    cov : (15, 15)
        Covariance of the error: pose (omega, v) on its right [rad, m], velocity in the world, gyro bias,
        accelerometer bias.
    how : str
        How it was found, for the report.
    """

    world_T_imu: Array
    velocity: Array
    gyro_bias: Array
    accel_bias: Array
    cov: Array
    how: str = ""

    def __post_init__(self) -> None:
        """Make the arrays read-only; ValueError if one has another shape."""
        shapes = {"world_T_imu": (4, 4), **dict.fromkeys(STATES, (3,)), "cov": (IMU_NAV, IMU_NAV)}
        for name, shape in shapes.items():
            value = np.array(getattr(self, name), float)
            if value.shape != shape:
                raise ValueError(f"{name} must be of shape {shape}, got {value.shape}")
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    @property
    def mean(self) -> Array:
        """Velocity and biases ``(9,)``, in the order of :data:`STATES`."""
        return np.concatenate([self.velocity, self.gyro_bias, self.accel_bias])
