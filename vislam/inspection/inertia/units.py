"""Units of raw inertia: the gyro's by the turns of the camera, the accelerometer's by gravity."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vislam.core.imu import ImuSeries
from vislam.inspection.finding import Finding, Measured
from vislam.inspection.inertia.turns import Turning
from vislam.models.imu import FORCE_UNITS, GRAVITY, RATE_UNITS
from vislam.repair.inertial import ImuUnits

CHECK = "imu units"
PATH = "data.repair.imu_units"
_OFF = 1.25
"""Factor of the turns that no calibration error explains."""
_POSSIBLE = 2.0
"""A median force is that of gravity up to this factor: a body is accelerated by less, half of the time."""
_NEAR = 1.4
"""A factor is that of a unit up to so much."""
_EXPLAINED = 0.5


@dataclass(frozen=True)
class _Unit:
    """Unit of a sensor in the file, by a factor that its samples are off, as they are configured to be read.

    Attributes
    ----------
    ratio : float
        What the samples of the file are to be divided by.
    known : mapping
        What 1 rad/s, or 1 m/s^2, is in units by their name.
    now : str
        As configured.
    """

    ratio: float
    known: Mapping[str, float]
    now: str

    @property
    def names(self) -> list[str]:
        """Units that the ratio is near to, the nearest first: no factor tells mg from cm/s^2."""
        off = {name: abs(np.log(self.ratio / size)) for name, size in self.known.items()}
        return sorted((name for name in off if off[name] < np.log(_NEAR)), key=off.__getitem__)

    @property
    def name(self) -> str:
        """The unit if it is told, else as configured."""
        return self.names[0] if len(self.names) == 1 else self.now

    @property
    def factor(self) -> float:
        """What the samples, as configured, are to be divided by."""
        return (self.known[self.names[0]] if self.names else self.ratio) / self.known[self.now]

    @property
    def remedy(self) -> str:
        """What it looks like."""
        if not self.names:
            return f"look at its unit, or at its scale (off by {self.ratio:.3g})"
        sizes = [f"{self.known[name]:.4g}" for name in self.names]
        return f"it looks like {' or '.join(self.names)}, divide by {' or '.join(sizes)}"


def check_units(
    series: ImuSeries, turning: Turning | None, configured: ImuUnits | None
) -> tuple[Finding, float, float]:
    """Units of both sensors; return what their samples are to be divided by, too.

    Parameters
    ----------
    series : ImuSeries
        As configured.
    turning : Turning or None
        None where the camera does not show its turns.
    configured : ImuUnits or None
        Units that it was read in.
    """
    now = ImuUnits() if configured is None else configured
    force = float(np.median(np.linalg.norm(series.accel, axis=1)))
    ratio = force / GRAVITY
    wrong, text = [], [f"median specific force {force:.4g} m/s^2"]
    rates = forces = None
    if not 1.0 / _POSSIBLE < ratio < _POSSIBLE:
        forces = _Unit(ratio * FORCE_UNITS[now.accel], FORCE_UNITS, now.accel)
        wrong.append(
            f"the accelerometer must show gravity, 9.81 m/s^2, got {force:.4g} read in {now.accel}: "
            f"{forces.remedy}"
        )
    measured: tuple[Measured, ...] = ()
    told = turning is not None and turning.correlation > _EXPLAINED and np.isfinite(turning.scale.sigma)
    if turning is not None and told:
        measured = (turning.scale,)
        scale = turning.scale.value
        text.append(str(turning.scale))
        if abs(np.log(scale)) > max(np.log(_OFF), 4.0 * turning.scale.sigma / scale):
            rates = _Unit(scale * RATE_UNITS[now.gyro], RATE_UNITS, now.gyro)
            wrong.append(
                f"the gyro, read in {now.gyro}, turns {scale:.3g} times as far as the camera: {rates.remedy}"
            )
    if wrong:
        finding = _wrong("; ".join([*wrong, *text]), measured, now, rates, forces)
        by_rate, by_force = (1.0 if one is None else one.factor for one in (rates, forces))
        return finding, by_rate, by_force
    if not told:
        text.append("too little turning, or too few sound tracks, to hold the unit of the gyro against")
        return Finding(CHECK, "unclear", "; ".join(text), measured), 1.0, 1.0
    return Finding(CHECK, "ok", "; ".join(text), measured), 1.0, 1.0


def _wrong(
    text: str, measured: tuple[Measured, ...], now: ImuUnits, rates: _Unit | None, forces: _Unit | None
) -> Finding:
    """Finding with the units that are told, and a reason at the file where one is not."""
    gyro, accel = (now.gyro if rates is None else rates.name), (now.accel if forces is None else forces.name)
    plain = ImuUnits()
    proposal = {}
    if (gyro, accel) != (now.gyro, now.accel):
        right = (gyro, accel) == (plain.gyro, plain.accel)
        proposal = {PATH: None if right else {"gyro": gyro, "accel": accel}}
    untold = any(one is not None and len(one.names) != 1 for one in (rates, forces))
    unknown = {"data.file": f"the units of the samples: {text}"} if untold else {}
    return Finding(CHECK, "fault", text, measured, proposal=proposal, unknown=unknown)
