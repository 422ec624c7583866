"""Raw inertia as the model of motion, from config and sequence."""

from collections.abc import Callable, Mapping
from dataclasses import asdict

from vislam.base.errors import ConfigError
from vislam.comparison.config import Config
from vislam.core.estimator import Inertia
from vislam.core.sequence import Sequence
from vislam.models.imu import ImuNoise

_UNUSED: Mapping[str, Callable[[Config], bool]] = {
    "noise.vertical_velocity to null": lambda config: config.noise.vertical_velocity is not None,
    "noise.acceleration_density to null": lambda config: config.noise.acceleration_density is not None,
    "noise.clock_sigma to 0": lambda config: config.noise.clock_sigma > 0.0,
    "noise.velocity_direction_sigma to 0": lambda config: config.noise.velocity_direction_sigma > 0.0,
}
"""What is of the twist alone, each by its remedy."""


def inertia(config: Config, sequence: Sequence) -> Inertia:
    """Noise and first state of ``motion: imu``; ConfigError if data or config lack what it takes."""
    if sequence.imu is None:
        raise ConfigError(
            f"motion: imu needs an accelerometer and a gyro, {sequence.name} has none; set motion to odometry"
        )
    asked = [remedy for remedy, used in _UNUSED.items() if used(config)]
    if asked:
        raise ConfigError(f"motion: imu makes no use of the recorded velocity; set {asked[0]}")
    if sequence.start is None:
        raise ConfigError(
            f"motion: imu starts from attitude, velocity and biases at the first frame, and {sequence.name} "
            "does not come with them; set motion to odometry"
        )
    return Inertia(ImuNoise(**asdict(config.noise.imu)), sequence.start)
