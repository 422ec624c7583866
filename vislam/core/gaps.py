"""What a straight line over a gap of a series of samples misses, by what such lines miss elsewhere in it.

Between two samples a time T apart, a signal that walks at random with ``q`` per second leaves the line that
joins them with the variance ``q t (T - t) / T``, a Brownian bridge, and the mean of that over the gap has the
variance ``q T / 12``. What q is, the samples say: those of the same series that lie in the middle between two
others about T apart are off the line through these by ``q T / 4``. It is measured at the length of the gap as
signals do not walk: of white noise of variance s^2 a line misses ``3 s^2 / 2`` in the middle and ``s^2 / 2``
in the mean, a third, and of a parabola the mean misses two thirds of what the middle does, so that both
ratios of variances, 1/3 and 4/9, are near to the walk's.

Over a gap of which frames see only parts, the error is taken for white, with the density at which the whole
gap has that variance: ``q T^2 / 12``. Beyond the last sample, which is held for a time D, there is no second
end: ``q D^2 / 3``, with q measured at 2 D.
"""

import numpy as np

from vislam.base.types import Array

_FEWEST = 20
"""Triples of samples that tell q."""
_MOST = 20_000
"""Triples that are looked at, evenly spread over the series."""
_NEAR, _INNER = 2.0**0.5, 0.25
"""A triple is about T long up to this factor, and its middle is so far inside of it."""
_PARTS = 8
"""Of an octave, within which lengths are the same."""
_WHITE = 1.5
"""Variance that a line misses of white noise of variance 1 in the middle."""


def bridged_densities(stamp: Array, values: Array, length: Array) -> Array:
    """Squared densities ``(g, c)`` of the error of a line over gaps, white within each [unit^2 s].

    Parameters
    ----------
    stamp : (n,)
        Increasing, two or more [s].
    values : (n, c)
        Samples of c signals.
    length : (g,)
        Of the gaps [s].
    """
    return np.asarray(_walks(stamp, values, length) * length[:, None] ** 2 / 12.0)


def held_densities(stamp: Array, values: Array, length: Array) -> Array:
    """Squared densities ``(g, c)`` where the first or the last sample is held for times ``(g,)``."""
    return np.asarray(_walks(stamp, values, 2.0 * length) * length[:, None] ** 2 / 3.0)


def _walks(stamp: Array, values: Array, length: Array) -> Array:
    """Variance of the walk ``(g, c)`` over a second at lengths ``(g,)``, one for each eighth of an octave."""
    octave = np.round(_PARTS * np.log2(length)).astype(int)
    each, which = np.unique(octave, return_inverse=True)
    found = [_walk(stamp, values, float(2.0 ** (one / _PARTS))) for one in each]
    return np.array(found).reshape(len(each), values.shape[1])[which]


def _walk(stamp: Array, values: Array, length: float) -> Array:
    """Variance of the walk ``(c,)`` over a second at a length, or at the longest below it that tells it."""
    first = np.arange(0, len(stamp), max(len(stamp) // _MOST, 1))
    while length > float(np.diff(stamp).min()):
        middle, last = (_nearest(stamp, stamp[first] + part * length) for part in (0.5, 1.0))
        before, after = stamp[middle] - stamp[first], stamp[last] - stamp[middle]
        span = before + after
        near = (span > length / _NEAR) & (span < length * _NEAR)
        fits = near & (np.minimum(before, after) > _INNER * span)
        if np.count_nonzero(fits) >= _FEWEST:
            one, two, three = (values[rows[fits]] for rows in (first, middle, last))
            share = (before / np.maximum(span, 1e-12))[fits, None]
            missed = two - (one + share * (three - one))
            return np.asarray(np.mean(missed**2 / (share * (1.0 - share) * span[fits, None]), axis=0))
        length *= 0.5
    return np.asarray(_WHITE * 4.0 / float(stamp[-1] - stamp[0]) * values.var(axis=0))


def _nearest(stamp: Array, time: Array) -> Array:
    """Rows ``(m,)`` of the stamps that are nearest to times ``(m,)``."""
    after = np.clip(np.searchsorted(stamp, time), 1, len(stamp) - 1)
    return np.asarray(after - (time - stamp[after - 1] < stamp[after] - time))
