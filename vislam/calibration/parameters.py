"""What can be calibrated: how each parameter is read from a config, written into one, and searched."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from vislam.base.types import Array
from vislam.comparison.config import Config, NoiseConfig
from vislam.repair.inertial import Clock
from vislam.repair.pixels import DisparityOffset

_SPAN = 100.0
"""Steps over which curvature is measured."""
_STEP = 5e-4
"""Of the logarithm of a level."""
_TINY = 1e-12
"""Logarithms are taken of no less."""
_GYRO, _FORWARD, _LATERAL, _VERTICAL = slice(0, 3), slice(3, 4), slice(4, 5), slice(5, 6)


@dataclass(frozen=True)
class Parameter:
    """One number of the config.

    Attributes
    ----------
    name, unit : str
        Name as a dotted path of the config.
    read : callable
        Its value in a config.
    write : callable
        The config with another value.
    logarithmic : bool
        A level, searched by its logarithm and never below ``lowest``; else an offset.
    step : float
        Length of a finite difference, in the searched scale: a small part of what it will be known to.
    lowest : float
        Smallest level; a level that ends there is not needed by the data. 0: the level is always needed, and
        stays near where it was where the data do not tell it.
    """

    name: str
    unit: str
    read: Callable[[Config], float]
    write: Callable[[Config, float], Config]
    logarithmic: bool
    step: float
    lowest: float = -np.inf

    @property
    def span(self) -> float:
        """Length over which the likelihood is seen to bend, in the searched scale."""
        return _SPAN * self.step

    def searched(self, value: float) -> float:
        """Value in the searched scale."""
        return float(np.log(max(value, self.lowest, _TINY))) if self.logarithmic else value

    def value(self, searched: float) -> float:
        """Value of a point in the searched scale."""
        return float(np.exp(searched)) if self.logarithmic else searched


def parameters(
    config: Config | None = None, *, inertial: bool = False, disparity_offset: bool = False
) -> list[Parameter]:
    """List what is searched: pixel noise, side slip and heave, clock, and what else is asked for or in use.

    Parameters
    ----------
    config : Config, optional
        Where it uses a vertical velocity or a smooth motion of the body, their levels are searched too.
        With ``motion: imu`` the white noise of gyro and accelerometer takes the place of side slip and heave.
    inertial : bool
        The noise of the gyro and of the forward velocity too. Innovations reach no farther than a track, so
        they cannot tell noise that accumulates from vibration between the samples or an error that all tracks
        share; on recorded sequences that puts the level too high, and the heading then follows the camera.
        With ``motion: imu`` the random walks of the biases too.
    disparity_offset : bool
        A constant error of all disparities.
    """
    raw = config is not None and config.motion == "imu"
    found = [
        _pixel("pixel_sigma_px", lowest=0.02),
        _pixel("drift_px", lowest=0.005),
        *(_RAW if raw else _ACROSS),
        _of_step("clock", Clock, "offset", unit="s", step=2e-5),
    ]
    if raw and inertial:
        found += _WALKS
    elif inertial:
        found += [
            _density("gyro", _GYRO, unit="rad/sqrt(s)", lowest=2e-5),
            _density("forward", _FORWARD, unit="m/sqrt(s)", lowest=2e-4),
        ]
    if config is not None and not raw and config.noise.acceleration_density is not None:
        found += [
            _acceleration("roll and pitch", slice(0, 2), unit="rad/s/sqrt(s)", lowest=1e-3),
            _acceleration("yaw", slice(2, 3), unit="rad/s/sqrt(s)", lowest=1e-3),
            _acceleration("forward", _FORWARD, unit="m/s/sqrt(s)", lowest=1e-2),
            _acceleration("lateral and vertical", slice(4, 6), unit="m/s/sqrt(s)", lowest=1e-2),
        ]
    if config is not None and not raw and config.noise.vertical_velocity is not None:
        found.append(_HEIGHT_WALK)
    if disparity_offset:
        found.append(_of_step("disparity_offset", DisparityOffset, "pixels", unit="px", step=2e-4))
    return found


def _pixel(name: str, *, lowest: float) -> Parameter:
    def read(config: Config) -> float:
        return float(getattr(config.noise, name))

    def write(config: Config, value: float) -> Config:
        return replace(config, noise=_changed(config.noise, {name: value}))

    return Parameter(f"noise.{name}", "px", read, write, True, _STEP, lowest)


def _density(name: str, part: slice, *, unit: str, lowest: float, of: str = "twist_density") -> Parameter:
    """Level of some components of a density; the others stay what they are, and these keep their ratios."""

    def read(config: Config) -> float:
        return float(np.mean(getattr(config.noise, of)[part]))

    def write(config: Config, value: float) -> Config:
        density = np.array(getattr(config.noise, of))
        mean = np.mean(density[part])
        density[part] = density[part] * (value / mean) if mean > 0.0 else value
        return replace(config, noise=_changed(config.noise, {of: tuple(density.tolist())}))

    return Parameter(f"noise.{of} ({name})", unit, read, write, True, _STEP, lowest)


def _imu(name: str, *, unit: str) -> Parameter:
    """Level of the noise of raw inertia, which no sensor is without, whatever a camera sees of it."""

    def read(config: Config) -> float:
        return float(getattr(config.noise.imu, name))

    def write(config: Config, value: float) -> Config:
        changed: dict[str, Any] = {name: value}
        return replace(config, noise=_changed(config.noise, {"imu": replace(config.noise.imu, **changed)}))

    return Parameter(f"noise.imu.{name}", unit, read, write, True, _STEP, 0.0)


def _changed(noise: NoiseConfig, values: dict[str, Any]) -> NoiseConfig:
    return replace(noise, **values)


def _of_step(
    name: str, kind: type[Clock | DisparityOffset], option: str, *, unit: str, step: float
) -> Parameter:
    """Offset that a repair step takes out; 0 where the step is off."""

    def read(config: Config) -> float:
        found = getattr(config.data.repair, name)
        return 0.0 if found is None else float(getattr(found, option))

    def write(config: Config, value: float) -> Config:
        changed: dict[str, Any] = {name: kind(**{option: value})}
        return replace(config, data=replace(config.data, repair=replace(config.data.repair, **changed)))

    return Parameter(f"data.repair.{name}.{option}", unit, read, write, False, step)


_acceleration = partial(_density, of="acceleration_density")


def _height_walk() -> Parameter:
    def read(config: Config) -> float:
        assert config.noise.vertical_velocity is not None
        return config.noise.vertical_velocity.walk

    def write(config: Config, value: float) -> Config:
        assert config.noise.vertical_velocity is not None
        return replace(
            config,
            noise=_changed(
                config.noise, {"vertical_velocity": replace(config.noise.vertical_velocity, walk=value)}
            ),
        )

    return Parameter("noise.vertical_velocity.walk", "m/sqrt(s)", read, write, True, _STEP, 1e-3)


_HEIGHT_WALK = _height_walk()
_ACROSS = (
    _density("lateral", _LATERAL, unit="m/sqrt(s)", lowest=2e-4),
    _density("vertical", _VERTICAL, unit="m/sqrt(s)", lowest=2e-4),
)
_RAW = (
    _imu("gyro_density", unit="rad/s/sqrt(Hz)"),
    _imu("accel_density", unit="m/s^2/sqrt(Hz)"),
)
_WALKS = (
    _imu("gyro_walk", unit="rad/s/sqrt(s)"),
    _imu("accel_walk", unit="m/s^2/sqrt(s)"),
)
MATCH = _pixel("matching_bias_px", lowest=0.02)
"""The stereo-matching bias, not searched but read off the filter (``vislam.calibration.match``)."""


_LARGEST_LOG, _LARGEST_STEPS = 0.7, 1000.0


def lowest_of(items: list[Parameter]) -> Array:
    """Bounds ``(p,)`` in the searched scale; minus infinity for an offset."""
    return np.array([np.log(item.lowest) if item.lowest > 0.0 else -np.inf for item in items])


def largest_of(items: list[Parameter]) -> Array:
    """Largest move ``(p,)`` of each at once, in the searched scale."""
    return np.array([_LARGEST_LOG if item.logarithmic else _LARGEST_STEPS * item.step for item in items])


def at(config: Config, items: list[Parameter], point: Array) -> Config:
    """Config with the parameters at a point ``(p,)`` of the searched scale."""
    for item, searched in zip(items, point, strict=True):
        config = item.write(config, item.value(float(searched)))
    return config


def point_of(config: Config, items: list[Parameter]) -> Array:
    """Point ``(p,)`` of a config in the searched scale."""
    return np.array([item.searched(item.read(config)) for item in items])


def scaled(config: Config, scale: float) -> Config:
    """Config with another pixel noise, white and drift alike."""
    noise = replace(
        config.noise,
        pixel_sigma_px=config.noise.pixel_sigma_px * scale,
        drift_px=config.noise.drift_px * scale,
    )
    return replace(config, noise=noise)
