"""Where a drive lies on the clock of a gyro that does not say so: at the offset where their rates agree.

With the mean rates y of the body over its steps, known on a clock of their own, and the means x of the gyro
over the same steps moved by an offset, ``y = x - b + n``: the offset is where the residuals less their mean
are smallest. All offsets are tried at which the gyro covers half of the steps, in steps of half of theirs.
Around the best one the mean square is ``s^2 + c delta^2``, to which noise of the gyro adds ripples, so a
parabola is fitted to it; its curvature says how sure the offset is, with a variance of ``s^2 / (3 n c)`` by n
steps, and a jackknife over blocks of the drive how much one part of it decides. Whether it is an offset at
all, tells how much smaller its residuals are than the smallest elsewhere.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.resampling import jackknife
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.imu import ImuSeries
from vislam.core.integrals import Integral, covered

_SHARE = 0.5
"""Of the steps that the gyro must cover at an offset that is tried."""
_APART_S = 2.0
"""An offset so far from the best one is another one [s]: the rates of a car change within a second or so."""
_BLOCKS = 12
_AT_ONCE = 200
"""Offsets that are tried at once."""
_GROUND = np.linspace(-1.0, 1.0, 21)
"""Places at which the ground of the valley is looked at, in steps of the search."""
_ROUNDS = 3
_JOINED = 5.5
"""Usual periods that a line joins; a gap beyond it has no rates."""


@dataclass(frozen=True)
class GyroAlignment:
    """Offset of a drive on the clock of a gyro.

    Attributes
    ----------
    offset : float
        What is added to the times of the drive to have those of the gyro [s].
    sigma : float
        Its standard deviation [s].
    residual : float
        Root mean square of what is left of the rates at it [rad/s].
    elsewhere : float
        Smallest one at any offset that is another [rad/s]; infinite if none was tried.
    correlation : (3,)
        Of the rates about each axis.
    steps, tried : int
        Steps that the gyro covers, and offsets that were tried.
    """

    offset: float
    sigma: float
    residual: float
    elsewhere: float
    correlation: Array
    steps: int
    tried: int


def align_gyro(stamp: Array, turns: Array, series: ImuSeries) -> GyroAlignment | None:
    """Find a drive in a series of samples; None if these are shorter than half of it.

    Parameters
    ----------
    stamp : (n + 1,)
        Times of the drive, increasing [s].
    turns : (n, 3)
        Rotation vectors of its steps, in the axes of the gyro [rad].
    series : ImuSeries
    """
    drive = _Drive(stamp, turns, series)
    step = 0.5 * float(np.median(np.diff(stamp)))
    tries = np.arange(series.stamp[0] - stamp[-1], series.stamp[-1] - stamp[0], step)
    found = np.concatenate(
        [drive.residuals(some) for some in np.array_split(tries, len(tries) // _AT_ONCE + 1)]
    )
    if not np.isfinite(found).any():
        return None
    offset = float(tries[np.argmin(found)])
    offset, _ = drive.refined(offset, drive.covered(np.array([offset])), reach=step)
    inside = drive.covered(np.array([offset]))
    offset, sigma = drive.refined(offset, inside, reach=step)
    blocks = [part for part in np.array_split(np.flatnonzero(inside), _BLOCKS) if len(part)]
    left_out = [drive.refined(offset, _without(inside, part), reach=step)[0] for part in blocks]
    other = found[np.abs(tries - offset) > _APART_S]
    return GyroAlignment(
        offset=offset,
        sigma=float(np.hypot(sigma, jackknife(np.array(left_out)))),
        residual=float(drive.spread(np.array([offset]), inside)[0]),
        elsewhere=float(other.min(initial=np.inf)),
        correlation=drive.correlation(offset, inside),
        steps=int(np.count_nonzero(inside)),
        tried=int(np.count_nonzero(np.isfinite(found))),
    )


def _without(mask: BoolArray, rows: IntArray) -> BoolArray:
    out = mask.copy()
    out[rows] = False
    return out


class _Drive:
    """Rates of the steps, and those of the gyro over them at any offset."""

    def __init__(self, stamp: Array, turns: Array, series: ImuSeries) -> None:
        self._begin, self._end = stamp[:-1], stamp[1:]
        self._length = (self._end - self._begin)[:, None]
        self._rates = turns / self._length
        self._series, self._gyro = series, Integral(series.stamp, series.gyro)

    def covered(self, offset: Array) -> BoolArray:
        """Steps ``(..., n)`` that samples cover at offsets ``(..., 1)``."""
        longest = _JOINED * self._series.period
        return covered(self._series, self._begin + offset, self._end + offset, longest=longest)

    def residuals(self, offset: Array) -> Array:
        """Root mean squares ``(m,)`` at offsets ``(m,)``; infinite where too few steps are covered."""
        inside = self.covered(offset[:, None])
        count = inside.sum(axis=1)
        enough = count >= max(_SHARE * inside.shape[1], 2)
        found = np.full(len(offset), np.inf)
        if enough.any():
            weight = inside[enough][:, :, None]
            left = weight * (self._rates - self._means(offset[enough][:, None]))
            mean = left.sum(axis=1) / count[enough][:, None]
            square = np.sum(left**2, axis=1) / count[enough][:, None] - mean**2
            found[enough] = np.sqrt(np.mean(square, axis=1))
        return found

    def spread(self, offset: Array, rows: BoolArray) -> Array:
        """The same over some steps."""
        left = (self._rates - self._means(offset[:, None]))[:, rows]
        return np.asarray(np.sqrt(np.mean(np.var(left, axis=1), axis=1)))

    def refined(self, start: float, rows: BoolArray, *, reach: float) -> tuple[float, float]:
        """Offset of the smallest mean square of some steps near another, and its standard deviation."""
        offset, sigma = start, np.inf
        for _ in range(_ROUNDS):
            square = self.spread(offset + reach * _GROUND, rows) ** 2
            curvature, slope, least = np.polyfit(_GROUND, square, 2)
            if not curvature > 0.0:
                break
            move = float(np.clip(-0.5 * slope / curvature, -1.0, 1.0))
            least = max(float(least - curvature * move**2), 0.0)
            offset += reach * move
            sigma = reach * float(np.sqrt(least / (3.0 * np.count_nonzero(rows) * curvature)))
        return offset, sigma

    def correlation(self, offset: float, rows: BoolArray) -> Array:
        """Correlation ``(3,)`` of the rates of some steps."""
        means = self._means(np.array([offset]))[rows]
        pairs = zip(means.T, self._rates[rows].T, strict=True)
        return np.array([np.corrcoef(one, other)[0, 1] for one, other in pairs])

    def _means(self, offset: Array) -> Array:
        """Means ``(..., n, 3)`` of the gyro over the steps, at offsets ``(..., 1)``."""
        at = np.stack([self._begin + offset, self._end + offset])
        begun, ended = self._gyro.once(at.reshape(-1)).reshape(*at.shape, 3)
        return np.asarray((ended - begun) / self._length)
