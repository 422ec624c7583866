"""The bound of a simulated comparison: whether it has one, and what it is."""

from collections.abc import Iterator

import numpy as np

from vislam.base.errors import ConfigError
from vislam.base.types import Array
from vislam.comparison.config import Config
from vislam.comparison.open import Dataset
from vislam.core.bound import Bound
from vislam.core.record import Tracks
from vislam.evaluation.bound import SMALLEST_WALK, BiasPrior, TrueDrive, bound
from vislam.models.odometry import MotionNoise
from vislam.models.shared_errors import SIZES, prior_name

_CLOSE = 1e-3
"""Share by which a noise may be told otherwise than it is drawn: rounding in a config."""
_NONE = {
    "data.simulation": (
        *("drift_px", "matching_bias_px", "matching_bias_share", "outlier_probability"),
        *("duplication_probability", "moving_share", "disparity_offset_px", "clock_offset"),
        *("navigation_frame_velocity", "navigation_frame_rates", "redetect_below", "stated_baseline"),
        *("camera_rotation", "principal_point_px", "focal_scale", "velocity_direction"),
        *map(prior_name, SIZES),
    ),
    "noise": (
        *("drift_px", "matching_bias_px", "vertical_velocity", "acceleration_density"),
        *map(prior_name, SIZES),
    ),
}
"""What a sequence with a bound has none of, by section."""


def refuse_unbounded(config: Config) -> None:
    """Raise ConfigError, in one line, if a config asks for a bound that its sequence does not have.

    The bound is that of independent noise which is drawn as it is told: for anything else it would be that of
    another problem.
    """
    if config.bound:
        for path, wanted, got in _unlike(config):
            raise ConfigError(
                f"{path}: expected {wanted}, got {got}: with bound: true a drive has the noise that it is "
                "told and no fault; see configs/efficiency.yaml"
            )


def drive_bound(config: Config, dataset: Dataset, given: Tracks) -> Bound | None:
    """Bound of the poses by the observations that are ``given``; None where it is not asked for."""
    if not config.bound:
        return None
    reference, sequence = dataset.reference, dataset.sequence
    assert reference is not None
    assert reference.pose is not None
    assert reference.bias is not None
    place = np.searchsorted(reference.track, given.track)
    drive = TrueDrive(
        stamp=sequence.stamp,
        world_T_imu=reference.pose,
        bias=np.broadcast_to(reference.bias, (len(sequence), 6)),
        step_twist=sequence.step_means()[0],
        tracks=given,
        point=reference.points_world[place],
        rig=sequence.rig,
    )
    noise = MotionNoise(np.array(config.noise.twist_density), np.array(config.noise.bias_walk))
    prior = BiasPrior(np.array(config.noise.bias_mean), np.array(config.noise.bias_sigma))
    return bound(drive, noise, prior)


def _unlike(config: Config) -> Iterator[tuple[str, str, str]]:
    """Path, what is expected there and what came, of all that does not fit a bound."""
    drive, noise = config.data.simulation, config.noise
    if config.motion != "odometry":
        yield "motion", "odometry, whose noise the bound is of", config.motion
        return
    if drive is None or config.data.file is not None:
        yield "data", "a simulation alone, whose truth is known", "a recording"
        return
    for section, of in (("data.simulation", drive), ("noise", noise)):
        for name in _NONE[section]:
            value = getattr(of, name)
            if np.any(value if isinstance(value, tuple) else bool(value)):
                yield f"{section}.{name}", "none", str(value)
    if drive.inertial_noise != "step":
        yield "data.simulation.inertial_noise", "step", drive.inertial_noise
    if not _same([drive.pixel_sigma_px], [noise.pixel_sigma_px]):
        yield "noise.pixel_sigma_px", f"{drive.pixel_sigma_px:g}, as drawn", f"{noise.pixel_sigma_px:g}"
    drawn = {
        "twist_density": np.sqrt(drive.period) * np.repeat([drive.gyro_sigma, drive.velocity_sigma], 3),
        "bias_mean": np.array([*drive.gyro_bias, *drive.velocity_bias]),
        "bias_sigma": np.array([*drive.gyro_bias_sigma, *drive.velocity_bias_sigma]),
        "bias_walk": np.repeat([drive.gyro_bias_walk, drive.velocity_bias_walk], 3),
    }
    for name, expected in drawn.items():
        got = np.array(getattr(noise, name))
        if not _same(expected, got, slack=SMALLEST_WALK if name == "bias_walk" else 0.0):
            yield f"noise.{name}", f"{_listed(expected)}, as drawn", _listed(got)
    if min(noise.twist_density) <= 0.0:
        yield "noise.twist_density", "more than 0", _listed(np.array(noise.twist_density))


def _same(one: Array | list[float], other: Array | list[float], *, slack: float = 0.0) -> bool:
    return bool(np.allclose(one, other, rtol=_CLOSE, atol=slack))


def _listed(values: Array) -> str:
    return "[" + ", ".join(f"{value:.6g}" for value in values) + "]"
