"""Intervals of what independent trials have in common: a share, a mean, a median."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import norm, t

from vislam.base.types import Array, IntArray

PROBABILITY = 0.95
"""Probability with which an interval is to hold the truth."""
_RESAMPLES = 4000
_AT_ONCE = 100_000
"""Values that are drawn at a time, so that memory does not grow with the number of trials."""
_SEED = 1927


@dataclass(frozen=True)
class Estimate:
    """A number of many trials and its 95 % interval.

    Attributes
    ----------
    value, low, high : float
        The ends are NaN where one trial alone cannot tell them.
    count : int
        Trials that it rests on.
    missing : int
        Trials that had nothing to add: the run failed, or the metric could not be computed.
    """

    value: float
    low: float
    high: float
    count: int
    missing: int = 0


def share(hits: float, count: int) -> Estimate:
    """Share of ``count > 0`` independent trials, with the interval of Wilson (JASA 1927).

    A hit may count half, as a tie does.
    """
    z = float(norm.isf(0.5 * (1.0 - PROBABILITY)))
    found = hits / count
    shrunk = (hits + 0.5 * z**2) / (count + z**2)
    half = z * np.sqrt(count * found * (1.0 - found) + 0.25 * z**2) / (count + z**2)
    # At a share of 0 or 1 rounding would put the end beside it.
    low, high = min(found, float(shrunk - half)), max(found, float(shrunk + half))
    return Estimate(found, max(0.0, low), min(1.0, high), count)


def positive_mean(values: Array) -> Estimate | None:
    """Mean of trials ``(n,)`` that are not negative, NaN where missing; None if all are missing.

    The interval is Student's of the logarithm, ``mean exp(-+ t s / (sqrt(n) mean))`` by the delta method
    (Casella and Berger, Statistical Inference, 5.5.4): of what is not negative no end of it is.
    """
    known = values[np.isfinite(values)]
    if not len(known):
        return None
    mean, low, high, missing = float(known.mean()), np.nan, np.nan, len(values) - len(known)
    if len(known) > 1 and mean > 0.0:
        quantile = t.isf(0.5 * (1.0 - PROBABILITY), len(known) - 1)
        factor = float(np.exp(quantile * known.std(ddof=1) / (np.sqrt(len(known)) * mean)))
        low, high = mean / factor, mean * factor
    return Estimate(mean, low, high, len(known), missing)


def bootstrap(values: Array, statistic: Callable[..., Any]) -> Estimate | None:
    """Statistic of trials ``(n,)``, NaN where missing, with its bootstrap interval; None if all are missing.

    The expanded percentile interval of Hesterberg (What teachers should know about the bootstrap, The
    American Statistician 2015): the plain one is too short for few trials. The same trials give the same
    interval.

    Parameters
    ----------
    values : (n,)
    statistic : callable
        ``np.mean`` or ``np.median``: takes values and an axis.
    """
    known = values[np.isfinite(values)]
    count = len(known)
    if not count:
        return None
    low, high = np.nan, np.nan
    if count > 1:
        drawn = np.concatenate([statistic(known[rows], axis=1) for rows in _resampled(count)])
        quantile = t.isf(0.5 * (1.0 - PROBABILITY), count - 1)
        tail = norm.sf(np.sqrt(count / (count - 1.0)) * quantile)
        low, high = np.quantile(drawn, [tail, 1.0 - tail])
    return Estimate(float(statistic(known)), float(low), float(high), count, len(values) - count)


def _resampled(count: int) -> Iterator[IntArray]:
    """Rows ``(m, count)`` of the resamples, a block of them at a time."""
    rng = np.random.default_rng(_SEED)
    block = max(1, _AT_ONCE // count)
    for first in range(0, _RESAMPLES, block):
        yield rng.integers(0, count, (min(block, _RESAMPLES - first), count))
