"""Errors that all tracks share, in the model that the noise is calibrated with.

A likelihood whose model lacks them puts them into whatever is free: bias, inertial noise. So while it is
maximised they are states, with small priors of their own where the config gives none.
"""

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from vislam.comparison.config import Config, NoiseConfig
from vislam.evaluation.shared_errors import EstimatedError
from vislam.models.shared_errors import (
    CAMERA_ROTATION,
    CLOCK,
    DISPARITY_OFFSET,
    FOCAL_SCALE,
    PRINCIPAL_POINT,
    SIZES,
    VELOCITY_DIRECTION,
    prior_name,
)

SIGMAS = {
    CAMERA_ROTATION: 0.003,
    DISPARITY_OFFSET: 0.2,
    PRINCIPAL_POINT: 1.0,
    FOCAL_SCALE: 0.003,
    CLOCK: 0.01,
    VELOCITY_DIRECTION: 0.003,
}
"""What a careful calibration leaves of each [rad, px, px, 1, s, rad]."""

_OF_THE_TWIST = (CLOCK, VELOCITY_DIRECTION)
"""Errors of a recorded velocity, of which raw inertia makes no use."""


def with_shared(config: Config, *, searched: Iterable[str] = ()) -> Config:
    """Config with priors of the shared errors for which it has none, but for those that are searched.

    Parameters
    ----------
    config : Config
    searched : iterable of str
        Dotted paths of what is searched: a repair of the same error leaves nothing to estimate.
    """
    without = _OF_THE_TWIST if config.motion == "imu" else ()
    steps = {path.split(".")[2] for path in searched if path.startswith("data.repair.")}
    return _with(
        config,
        {
            name: sigma
            for name, sigma in SIGMAS.items()
            if name not in steps and name not in without and not _sigma(config.noise, name)
        },
    )


def without_shared(config: Config, *, as_in: Config) -> Config:
    """Config with the priors of the shared errors that another has."""
    return _with(config, {name: _sigma(as_in.noise, name) for name in SIZES})


def with_priors(config: Config, found: Iterable[EstimatedError]) -> Config:
    """Config with priors that hold what was found, never smaller than its own."""
    return _with(config, {item.name: max(_prior(item), _sigma(config.noise, item.name)) for item in found})


def _prior(found: EstimatedError) -> float:
    """Standard deviation that an estimate is one of, and no surprise."""
    return float(f"{float(np.max(np.hypot(found.value, found.sigma))):.3g}")


def _sigma(noise: NoiseConfig, name: str) -> float:
    return float(getattr(noise, prior_name(name)))


def _with(config: Config, sigmas: dict[str, float]) -> Config:
    changed: dict[str, Any] = {prior_name(name): sigma for name, sigma in sigmas.items()}
    return replace(config, noise=replace(config.noise, **changed))
