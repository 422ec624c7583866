"""Units of raw inertia: the gyro's by the turns of the camera, the accelerometer's by gravity."""

import numpy as np

from vislam.core.imu import ImuSeries
from vislam.inspection.finding import Finding, Measured
from vislam.inspection.inertia.turns import Turning
from vislam.models.imu import GRAVITY

CHECK = "imu units"
_RATES = {"deg/s": 180.0 / np.pi, "mrad/s": 1000.0, "mdeg/s": 180e3 / np.pi, "turns a minute": 30.0 / np.pi}
_FORCES = {"g": 1.0 / GRAVITY, "mg": 1000.0 / GRAVITY, "cm/s^2": 100.0, "mm/s^2": 1000.0}
"""What 1 rad/s and 1 m/s^2 are in other units."""
_OFF = 1.25
"""Factor of the turns that no calibration error explains."""
_POSSIBLE = 2.0
"""A median force is that of gravity up to this factor: a body is accelerated by less, half of the time."""
_NEAR = 1.4
"""A factor is that of a unit up to so much."""
_EXPLAINED = 0.5


def check_units(series: ImuSeries, turning: Turning | None) -> tuple[Finding, float, float]:
    """Units of both sensors; return what their samples are to be divided by, too.

    Parameters
    ----------
    series : ImuSeries
    turning : Turning or None
        None where the camera does not show its turns.
    """
    force = float(np.median(np.linalg.norm(series.accel, axis=1)))
    ratio = force / GRAVITY
    wrong, text = [], [f"median specific force {force:.4g} m/s^2"]
    by_force = by_rate = 1.0
    if not 1.0 / _POSSIBLE < ratio < _POSSIBLE:
        units = _units(ratio, _FORCES)
        by_force = _FORCES[units[0]] if units else ratio
        wrong.append(
            f"the accelerometer must show gravity, 9.81 m/s^2, got {force:.4g}: {_remedy(ratio, _FORCES)}"
        )
    measured: tuple[Measured, ...] = ()
    told = turning is not None and turning.correlation > _EXPLAINED and np.isfinite(turning.scale.sigma)
    if turning is not None and told:
        measured = (turning.scale,)
        scale = turning.scale.value
        text.append(str(turning.scale))
        if abs(np.log(scale)) > max(np.log(_OFF), 4.0 * turning.scale.sigma / scale):
            by_rate = scale
            wrong.append(
                f"the gyro must be in rad/s, it turns {scale:.3g} times as far as the camera: "
                f"{_remedy(scale, _RATES)}"
            )
    if wrong:
        unknown = {"data.file": f"the units of the samples: {'; '.join(wrong)}"}
        return (
            Finding(CHECK, "fault", "; ".join([*wrong, *text]), measured, unknown=unknown),
            by_rate,
            by_force,
        )
    if not told:
        text.append("too little turning, or too few sound tracks, to hold the unit of the gyro against")
        return Finding(CHECK, "unclear", "; ".join(text), measured), by_rate, by_force
    return Finding(CHECK, "ok", "; ".join(text), measured), by_rate, by_force


def _units(ratio: float, units: dict[str, float]) -> list[str]:
    """Units that a factor is near to, the nearest first: no factor tells mg from cm/s^2."""
    off = {name: abs(np.log(ratio / size)) for name, size in units.items()}
    return sorted((name for name in units if off[name] < np.log(_NEAR)), key=off.__getitem__)


def _remedy(ratio: float, units: dict[str, float]) -> str:
    near = _units(ratio, units)
    if not near:
        return f"look at its unit, or at its scale (off by {ratio:.3g})"
    sizes = [f"{units[name]:.4g}" for name in near]
    return f"it looks like {' or '.join(near)}, divide by {' or '.join(sizes)}"
