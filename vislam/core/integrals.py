"""Integrals of a series of samples that are joined by straight lines."""

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.imu import ImuSeries


class Integral:
    """Integral of a series over time, and the integral of that.

    Parameters
    ----------
    stamp : (n,)
        Increasing [s].
    value : (n, ...)
    """

    def __init__(self, stamp: Array, value: Array) -> None:
        shape = (-1,) + (1,) * (value.ndim - 1)
        dt = np.diff(stamp).reshape(shape)
        self._stamp, self._value = stamp, value
        once = np.cumsum(dt * 0.5 * (value[1:] + value[:-1]), axis=0)
        self._once = np.concatenate([np.zeros_like(value[:1]), once])
        more = dt * self._once[:-1] + dt**2 * (2.0 * value[:-1] + value[1:]) / 6.0
        self._twice = np.concatenate([np.zeros_like(value[:1]), np.cumsum(more, axis=0)])

    def once(self, time: Array) -> Array:
        """Integral ``(m, ...)`` from the first sample to times ``(m,)`` within the series."""
        k, dt, slope = self._at(time)
        return np.asarray(self._once[k] + dt * self._value[k] + 0.5 * dt**2 * slope)

    def twice(self, time: Array) -> Array:
        """Integral ``(m, ...)`` of the integral."""
        k, dt, slope = self._at(time)
        return np.asarray(
            self._twice[k] + dt * self._once[k] + 0.5 * dt**2 * self._value[k] + dt**3 / 6.0 * slope
        )

    def _at(self, time: Array) -> tuple[IntArray, Array, Array]:
        k = np.clip(np.searchsorted(self._stamp, time, side="right") - 1, 0, len(self._stamp) - 2)
        shape = (-1,) + (1,) * (self._value.ndim - 1)
        whole = (self._stamp[k + 1] - self._stamp[k]).reshape(shape)
        return k, (time - self._stamp[k]).reshape(shape), (self._value[k + 1] - self._value[k]) / whole


def covered(series: ImuSeries, first: Array, last: Array, *, longest: float) -> BoolArray:
    """Which of some intervals lie within a series whose samples are close enough, ``(m,)``.

    Parameters
    ----------
    series : ImuSeries
    first, last : (m,)
        On its clock [s].
    longest : float
        Distance of two samples that a line still joins [s].
    """
    wide = np.flatnonzero(np.diff(series.stamp) > longest)
    begun, ended = np.searchsorted(series.stamp[wide + 1], first), np.searchsorted(series.stamp[wide], last)
    return np.asarray((begun >= ended) & (first >= series.stamp[0]) & (last <= series.stamp[-1]))
