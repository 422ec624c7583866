"""White noise and random walk of a sensor at rest, by its Allan deviation.

IEEE Std 952-1997, annex C: with overlapping clusters of length tau the variance is ``N^2 / tau`` of white
noise of density N and ``K^2 tau / 3`` of a random walk K of the bias.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array

_LENGTHS = 24
_FIRST = 4
"""Shortest cluster, in samples: a shorter one sees what the sensor filters."""
_LAST = 0.1
"""Longest cluster, as a share of the standstill."""
_AVERAGED = 3
"""Lengths of the least white noise that are averaged."""


@dataclass(frozen=True)
class Allan:
    """Allan variance of three axes, and what is read off it.

    Attributes
    ----------
    length : (l,)
        Of the clusters [s].
    variance : (l,)
        Mean of the axes, in the unit of the samples, squared.
    density, walk : float
        N, in the unit of the samples times sqrt(s), and K, in that over sqrt(s).
    sigma : float
        Standard deviation of N.
    walks : bool
        Whether the walk is seen: at the longest clusters it is more than the white noise.
    """

    length: Array
    variance: Array
    density: float
    walk: float
    sigma: float
    walks: bool


def allan(samples: Array, *, period: float) -> Allan:
    """Allan variance of samples ``(n, 3)`` of a sensor at rest, evenly spaced by ``period`` [s].

    Vibration adds to the variance at clusters of a few of its periods, and motion at all, so that the density
    is where ``variance * length`` is least.
    """
    total = len(samples)
    most = max(int(_LAST * total), _FIRST + 1)
    many = np.unique(np.geomspace(_FIRST, most, _LENGTHS).astype(int))
    theta = np.concatenate([np.zeros((1, samples.shape[1])), np.cumsum(samples, axis=0)]) * period
    length = many * period
    variance = np.array(
        [np.mean((theta[2 * m :] - 2.0 * theta[m:-m] + theta[: -2 * m]) ** 2) for m in many]
    ) / (2.0 * length**2)
    lowest = np.sort(np.argsort(variance * length)[:_AVERAGED])
    white = float(np.mean((variance * length)[lowest]))
    longer = slice(int(lowest[0]), None)
    walk = _walk(length[longer], variance[longer] - white / length[longer])
    density = float(np.sqrt(white))
    clusters = 3.0 * total * period / float(length[lowest].mean())
    return Allan(
        length,
        variance,
        density,
        float(np.sqrt(walk)),
        density / float(np.sqrt(2.0 * clusters)),
        bool(walk * length[-1] / 3.0 > white / length[-1]),
    )


def _walk(length: Array, rest: Array) -> float:
    """K^2 by least squares from what is left of the variance, relative to ``1 / length``."""
    column = length**2 / 3.0
    return max(float(column @ (rest * length) / (column @ column)), 0.0)
