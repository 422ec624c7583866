"""The offset between the clocks of a trajectory and its reference, by what fits best, with its interval.

The error of an aligned trajectory whose stamps are late by ``d`` is the velocity times ``d`` beside the rest,
so the offset is where the rigid or similar alignment leaves least. It is searched for over a grid first: the
cost has other minima where the motion repeats itself.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from vislam.base.types import Array
from vislam.core.stamped import Stamped
from vislam.evaluation.alignment import align
from vislam.evaluation.statistics import effective_errors

_GRID = 81
_MOST_ROWS = 1500
"""Rows that the search takes, evenly spread: it is about one number."""
_FEWEST = 10
_QUANTILE = 1.96
_LEAST_COMMON = 0.5
"""Share of the rows that must stay on the reference at an offset."""
_CORRELATED = 0.7
"""Correlation of the speeds above which clocks without any common time are laid on each other."""


@dataclass(frozen=True)
class Offset:
    """What must be added to the stamps of a trajectory.

    Attributes
    ----------
    value, low, high : float
        Best value and its 95 % interval [s].
    before, after : float
        RMS position error, aligned, without it and with it [m]; NaN before where the clocks have no time in
        common.
    """

    value: float
    low: float
    high: float
    before: float
    after: float

    def __str__(self) -> str:
        return f"{self.value:+.4f} s (95 %: {self.low:+.4f} to {self.high:+.4f} s)"


def estimate_offset(estimate: Stamped, reference: Stamped, *, reach: float, scaled: bool) -> Offset | None:
    """Find the offset within ``reach`` [s]; None where too little is in common, or nothing moves.

    Parameters
    ----------
    estimate, reference : Stamped
        Matched by neither place nor frame, but by time.
    reach : float
        Farthest offset that is tried [s].
    scaled : bool
        Whether the scale of the trajectory is free.
    """
    if not (estimate.timed and reference.timed) or min(len(estimate), len(reference)) < _FEWEST:
        return None
    thin = estimate.take(np.unique(np.linspace(0, len(estimate) - 1, _MOST_ROWS).astype(int)))
    thin = replace(thin, pose=None, cov=None)
    bare = replace(reference, pose=None, cov=None)

    def cost(offset: float) -> float:
        found = _residual(thin, bare, offset, scaled=scaled)
        return np.inf if found is None else float(np.sqrt(np.mean(np.sum(found**2, axis=1))))

    before = cost(0.0)
    centre = 0.0 if np.isfinite(before) else _by_speed(thin, bare)
    if centre is None:
        return None
    tried = np.linspace(-reach, reach, _GRID)
    costs = np.array([cost(centre + offset) for offset in tried])
    if not np.isfinite(costs).any():
        return None
    best = int(np.argmin(costs))
    step = tried[1] - tried[0]
    # About the centre, as the search is to a share of its variable; it computes with what it is given.
    worst = 2.0 * float(costs[np.isfinite(costs)].max()) + 1.0
    found = minimize_scalar(
        lambda offset: min(cost(centre + offset), worst),
        bounds=(tried[best] - step, tried[best] + step),
        method="bounded",
        options={"xatol": 1e-7},
    )
    value, after = centre + float(found.x), float(found.fun)
    if before <= after:
        value, after = 0.0, before
    spread = _spread(thin, bare, value, scaled=scaled)
    return Offset(
        value,
        value - _QUANTILE * spread,
        value + _QUANTILE * spread,
        before if np.isfinite(before) else float("nan"),
        after,
    )


def _residual(estimate: Stamped, reference: Stamped, offset: float, *, scaled: bool) -> Array | None:
    at = estimate.stamp + offset
    inside = (at >= reference.stamp[0]) & (at <= reference.stamp[-1])
    whole = min(_LEAST_COMMON, (reference.stamp[-1] - reference.stamp[0]) / max(np.ptp(estimate.stamp), 1e-9))
    if inside.sum() < max(_FEWEST, _LEAST_COMMON * whole * len(at)):
        return None
    target = reference.interpolated(at[inside]).position
    own = estimate.position[inside, : target.shape[1]]
    rotation, translation = align(own, target)
    turned = own @ rotation.T + translation
    if scaled:
        centred, wanted = turned - turned.mean(axis=0), target - target.mean(axis=0)
        turned = target.mean(axis=0) + centred * (np.sum(centred * wanted) / max(np.sum(centred**2), 1e-300))
    return np.asarray(turned - target)


def _spread(estimate: Stamped, reference: Stamped, offset: float, *, scaled: bool) -> float:
    """Standard deviation of the offset, by least squares with errors that stay correlated [s].

    The derivative of the residuals is taken after each alignment, so that what of the velocity the alignment
    undoes does not count.
    """
    tick = max(1e-4, 0.1 * estimate.step)
    found = [_residual(estimate, reference, offset + side * tick, scaled=scaled) for side in (-1, 0, 1)]
    if any(one is None for one in found):
        return float("inf")
    low, middle, high = (one for one in found if one is not None)
    count = min(len(low), len(middle), len(high))
    slope = (high[-count:] - low[-count:]) / (2.0 * tick)
    information = float(np.sum(slope**2))
    if information <= 0.0:
        return float("inf")
    noise = float(np.mean(middle**2))
    return float(np.sqrt(noise / information * len(middle) / effective_errors(middle)))


def _by_speed(estimate: Stamped, reference: Stamped) -> float | None:
    """Offset at which the speeds of both are most alike, whatever the clocks; None where they are not."""
    step = max(estimate.step, reference.step)
    if step <= 0.0:
        return None
    profiles = []
    for side in (estimate, reference):
        at = np.arange(side.stamp[0], side.stamp[-1], step)
        if not _FEWEST <= len(at) <= 10**6:
            return None
        speed = np.linalg.norm(np.diff(side.interpolated(at).position, axis=0), axis=1)
        profiles.append(speed - speed.mean())
    own, other = profiles
    size = len(own) + len(other) - 1
    product = np.fft.irfft(np.fft.rfft(other, size) * np.conj(np.fft.rfft(own, size)), size)
    lags = np.concatenate([np.arange(len(other)), np.arange(-len(own) + 1, 0)])
    best = int(np.argmax(product))
    overlap = slice(max(0, -lags[best]), min(len(own), len(other) - lags[best]))
    mine, others = own[overlap], other[overlap.start + lags[best] : overlap.stop + lags[best]]
    norm = float(np.sqrt(np.sum(mine**2) * np.sum(others**2)))
    if norm <= 0.0 or float(np.sum(mine * others)) < _CORRELATED * norm:
        return None
    return float(reference.stamp[0] + lags[best] * step - estimate.stamp[0])
