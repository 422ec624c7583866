"""Raw inertia in the config made for a recording: repairs, noise, and whether it tells the first state."""

from dataclasses import asdict, fields
from typing import Any

from vislam.base import settings
from vislam.comparison.config import ImuNoiseConfig
from vislam.core.sequence import Sequence
from vislam.initialisation import NotFoundError, initialise, noise_factor, scaled
from vislam.inspection.finding import Inspection
from vislam.models.imu import ImuNoise
from vislam.repair import RepairConfig

_ESTIMATORS: dict[str, dict[str, Any]] = {
    "stereo_vo": {},
    "ekf_invariant": {},
    "eks": {},
    "isam2": {},
    "batch": {},
}
_REPAIR = "data.repair."
_CHECKS = "imu "
"""What the names of the checks of raw inertia begin with."""
_DENSITIES = ("gyro_density", "accel_density", "gyro_walk", "accel_walk")


def with_repairs(tree: dict[str, Any], sequence: Sequence, result: Inspection) -> Sequence:
    """Set the repairs that raw inertia asks for in a config; return the sequence with them.

    Those are its units, its clock and its axes, as the checks of raw inertia found them faulty. What checks
    of a velocity have found where none is recorded stays out.

    Parameters
    ----------
    tree : dict
        The config as plain data.
    sequence : Sequence
        Unrepaired.
    result : Inspection
        Of the same.
    """
    found: dict[str, Any] = {}
    for finding in result.findings:
        if finding.check.startswith(_CHECKS):
            found |= {path: value for path, value in finding.proposal.items() if path.startswith(_REPAIR)}
    for path, value in found.items():
        settings.put(tree, path, value)
    asked = settings.parse(RepairConfig, {path.removeprefix(_REPAIR): value for path, value in found.items()})
    for item in fields(RepairConfig):
        step = getattr(asked, item.name)
        if _REPAIR + item.name in found and step is not None:
            sequence = step.apply(sequence)
    return sequence


def with_raw_inertia(tree: dict[str, Any], sequence: Sequence, stated: ImuNoise | None) -> list[str]:
    """Set ``motion: imu`` and its noise in a config, if the data tell the first state; return what to say.

    The white noise is that of the recording's own files, or of a data sheet where it has none, times the
    factor by which tracks and inertia are farther apart than it allows.
    """
    told = "its own files" if stated is not None else "the default, a data sheet's"
    noise = ImuNoise(**asdict(ImuNoiseConfig())) if stated is None else stated
    try:
        initialise(sequence, noise)
    except NotFoundError as why:
        return [f"raw inertia is left out (motion: odometry): {why}"]
    factor = noise_factor(sequence, noise)
    noise = scaled(noise, factor)
    for name in _DENSITIES:
        settings.put(tree, f"noise.imu.{name}", float(f"{getattr(noise, name):.3g}"))
    settings.put(tree, "motion", "imu")
    tree["estimators"] = _ESTIMATORS
    return [
        f"raw inertia (motion: imu): {len(sequence.imu or ())} samples, {sequence.counts.get('imu_gaps', 0)} "
        f"gaps, {_covered(sequence):.0%} of the recording covered; white noise that of {told}, times "
        f"{factor:.2g}, by which tracks and inertia differ"
    ]


def _covered(sequence: Sequence) -> float:
    """Share of the recording with inertial samples."""
    assert sequence.imu is not None
    steps = sequence.imu.steps(sequence.stamp, clock_offset=sequence.clock_offset)
    return 1.0 - sum(step.missing for step in steps) / float(sequence.stamp[-1] - sequence.stamp[0])
