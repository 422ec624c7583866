"""Raw inertia as the model of motion, from config and sequence."""

from collections.abc import Callable, Mapping
from dataclasses import asdict, replace

import numpy as np

from vislam.base.errors import ConfigError
from vislam.comparison.config import Config
from vislam.comparison.open import Dataset
from vislam.core.estimator import Inertia
from vislam.core.sequence import Sequence
from vislam.core.standstill import Standstill, standstill
from vislam.initialisation import InitialisationSettings, NotFoundError, initialise
from vislam.models.imu import ImuNoise, ImuPrior

_UNUSED: Mapping[str, Callable[[Config], bool]] = {
    "noise.vertical_velocity to null": lambda config: config.noise.vertical_velocity is not None,
    "noise.acceleration_density to null": lambda config: config.noise.acceleration_density is not None,
    "noise.clock_sigma to 0": lambda config: config.noise.clock_sigma > 0.0,
    "noise.velocity_direction_sigma to 0": lambda config: config.noise.velocity_direction_sigma > 0.0,
}
"""What is of the twist alone, each by its remedy."""


def inertia(config: Config, dataset: Dataset) -> Inertia:
    """What ``motion: imu`` takes; ConfigError if data or config lack it."""
    sequence = dataset.sequence
    if sequence.imu is None:
        raise ConfigError(
            f"motion: imu needs an accelerometer and a gyro, {sequence.name} has none; set motion to odometry"
        )
    asked = [remedy for remedy, used in _UNUSED.items() if used(config)]
    if asked:
        raise ConfigError(f"motion: imu makes no use of the recorded velocity; set {asked[0]}")
    noise = ImuNoise(**asdict(config.noise.imu))
    prior = _found(sequence, noise) if sequence.start is None else sequence.start
    return Inertia(noise, prior, _standing(config, dataset, noise))


def started(config: Config, dataset: Dataset) -> Dataset:
    """The dataset with what ``motion: imu`` takes of it: standstill, and first state with a note on it.

    Nothing changes with another motion, and of the first state where the recording says what it is.
    """
    if config.motion != "imu":
        return dataset
    whole = inertia(config, dataset)
    dataset, found = replace(dataset, standstill=whole.standstill), whole.prior
    if dataset.sequence.start is not None:
        return dataset
    sequence = replace(dataset.sequence, start=found)
    return replace(dataset, sequence=sequence, notes=(*dataset.notes, f"initial state, {found.how}"))


def _standing(config: Config, dataset: Dataset, noise: ImuNoise) -> Standstill | None:
    """Where the body stands still, if that is to be used, as it was decided or from the data."""
    wanted = config.noise.zero_velocity
    if wanted is None:
        return None
    if dataset.standstill is not None:
        return dataset.standstill
    sequence, pixels = dataset.sequence, config.noise.pixel_sigma_px
    found = standstill(
        sequence.at_keyframes(), noise, pixel_sigma=pixels, slowest=wanted.slowest, sigma=wanted.sigma
    )
    if sequence.keyframe is None:
        return found
    frames = np.zeros(len(sequence), bool)
    frames[sequence.keyframe] = found.frames
    return replace(found, frames=frames)


def _found(sequence: Sequence, noise: ImuNoise) -> ImuPrior:
    """First state from the data; ConfigError with the reason if they do not tell it."""
    settings = InitialisationSettings()
    try:
        return initialise(sequence.at_keyframes(), noise, settings).as_prior(settings)
    except NotFoundError as why:
        raise ConfigError(
            f"motion: imu starts from attitude, velocity and biases, and {sequence.name} does not tell them: "
            f"{why}; or set motion to odometry"
        ) from None
