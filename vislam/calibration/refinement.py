"""Maximum of a likelihood by its exact score: quasi-Newton steps from a point and an information.

The score costs one run of the filter and its backward pass (:mod:`vislam.estimators.ekf.scores`) and two runs
for each parameter that is no level of noise, where differences cost two runs a parameter. The first step is
that of Fisher's scoring; from there on what the score has changed by is taken into the information (BFGS;
Nocedal and Wright, *Numerical Optimization*, 2006, eq. 6.19).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from vislam.base import linear
from vislam.base.types import Array, BoolArray
from vislam.calibration.search import Round
from vislam.calibration.target import Point

ROUNDS_BY_SCORES = 30
"""Rounds, at most, where each takes few runs."""
_HALVINGS = 4
"""How often a step is halved that gains nothing."""
_LEAST = 0.2
"""Share of the curvature that was expected along a step from which on what was found there is believed."""
_NO_MOVE = 1e-9
"""A box has an inside also where a level is at its lowest value."""
_RESTS = 0.2
"""Share of the tolerance that is worth another step: a step takes few runs."""


@dataclass(frozen=True)
class Bounds:
    """Of points ``(p,)``.

    Attributes
    ----------
    lowest, largest : (p,)
        Lowest values, and largest moves at once.
    free : (p,)
        Parameters that move at all.
    """

    lowest: Array
    largest: Array
    free: BoolArray

    def inside(self, here: Point) -> BoolArray:
        """Parameters that are not held at their lowest value by the score."""
        return self.free & ~((here.value <= self.lowest + 1e-9) & (here.gradient < 0.0))

    def step(self, here: Point, information: Array) -> tuple[Array, float]:
        """Best step ``(p,)`` within the bounds for the quadratic of score and information, and its gain."""
        inside, move = self.inside(here), np.zeros(len(here.value))
        if inside.any():
            # In units of the standard deviation that each has alone, so that none is lost beside others.
            matrix, scale = linear.scaled(information[np.ix_(inside, inside)])
            root = np.linalg.cholesky(matrix)
            wanted = solve_triangular(root, here.gradient[inside] / scale, lower=True)
            least = np.maximum(-self.largest, self.lowest - here.value)[inside]
            box = (np.minimum(least, -_NO_MOVE) * scale, self.largest[inside] * scale)
            move[inside] = lsq_linear(root.T, wanted, box, method="bvls").x / scale
        move = np.maximum(here.value + move, self.lowest) - here.value
        return move, float(here.gradient @ move - 0.5 * move @ information @ move)


def refined(
    scored: Callable[[Array], Point],
    start: Array,
    *,
    information: Array,
    bounds: Bounds,
    tolerance: float = 0.5,
    most: int = ROUNDS_BY_SCORES,
    on_round: Callable[[Round], None] = lambda ended: None,
) -> Point | None:
    """Point of the maximum; None where no step leads there.

    Parameters
    ----------
    scored : callable
        Likelihood and score at a point.
    start : (p,)
    information : (p, p)
        Of all frames, roughly.
    bounds : Bounds
    tolerance : float
        Where the quadratic of score and information expects a gain of less, it has converged.
    most : int
        Rounds after which it is given up.
    on_round : callable
        Is given each round that has ended.
    """
    here = scored(np.maximum(start, bounds.lowest))
    for rounds in range(1, most + 1):
        move, expected = bounds.step(here, information)
        if not np.isfinite(here.log_likelihood):
            return None
        if expected < _RESTS * tolerance:
            return here
        there = _better(here, move, scored)
        if there is None:
            return here if expected < tolerance else None
        gain = there.log_likelihood - here.log_likelihood
        information = _updated(information, there.value - here.value, here.gradient - there.gradient)
        here = there
        on_round(Round(rounds, here.value, here.log_likelihood, gain))
    return None


def _better(here: Point, move: Array, scored: Callable[[Array], Point]) -> Point | None:
    """Where a move leads, halved until it gains something; None if it does not."""
    for _ in range(_HALVINGS + 1):
        there = scored(here.value + move)
        if there.log_likelihood > here.log_likelihood:
            return there
        move = 0.5 * move
    return None


def _updated(information: Array, move: Array, change: Array) -> Array:
    """Information that a move has found by how it changed the score, if that is any."""
    expected = information @ move
    if change @ move < _LEAST * (expected @ move):
        return information
    out = information - np.outer(expected, expected) / (expected @ move)
    return np.asarray(out + np.outer(change, change) / (change @ move))
