"""Maximum of a likelihood that is a sum over frames, by scoring with secants.

The score of each frame and the expected information come from one run of the filter for each parameter, a
short step away, beside the run at the point itself (N. K. Gupta and R. K. Mehra, *Computational aspects of
maximum likelihood estimation and reduction in sensitivity function calculations*, IEEE Trans. Autom. Control
19 (1974) 774-783). Where the model does not hold, the likelihood is flatter along some directions than that
information says; the changes of the score over the steps taken correct it (BFGS from the information of each
point, a structured secant: Dennis, Gay and Welsch, ACM Trans. Math. Softw. 7 (1981) 348-368; Nocedal and
Wright, *Numerical Optimization*, 2006, eq. 6.19). The standard deviations are those of the sandwich (Huber
1967; White 1982), which hold where the model does not.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_triangular
from scipy.optimize import lsq_linear

from vislam.base import linear
from vislam.base.types import Array, BoolArray

Evaluate = Callable[[list[Array]], list[float]]
"""From points ``(p,)`` to their log likelihoods."""

_log = logging.getLogger("vislam.calibration")
ROUNDS = 12
"""Rounds of a search, at most."""
_SHORTER = (0.5, 0.25, 0.125)
"""Parts of a move that gains nothing that are tried in its place."""
_LEAST = 0.05
"""Share of the curvature that was expected along a step from which on what was found there is believed."""
_NO_MOVE = 1e-9
"""A box has an inside also where a level is at its lowest value."""
_MAY_COST = 20.0
"""Times the tolerance that a level may be worth by a parabola for its lowest value to be tried."""


@dataclass(frozen=True)
class Local:
    """A likelihood at a point ``(p,)``, and what it is beside it.

    Attributes
    ----------
    value : (p,)
    log_likelihood : float
        Of all frames; minus infinity where the filter fails.
    scores : (T, p)
        Score of each frame.
    information : (p, p)
        Expected information of all frames.
    """

    value: Array
    log_likelihood: float
    scores: Array
    information: Array

    @property
    def gradient(self) -> Array:
        """Score ``(p,)`` of all frames."""
        return np.asarray(self.scores.sum(axis=0))


@dataclass(frozen=True)
class Round:
    """Where a round of the search ended.

    Attributes
    ----------
    number : int
        From 1.
    point : (p,)
        The best so far.
    log_likelihood, gain : float
        There, and what the round has added.
    """

    number: int
    point: Array
    log_likelihood: float
    gain: float


@dataclass(frozen=True)
class Maximum:
    """Where the search ended.

    Attributes
    ----------
    point : (p,)
    sigma : (p,)
        Standard deviation; infinite for parameters at their lowest value.
    log_likelihood : float
    rounds : int
    began : Local
        Where the last round began.
    information : (p, p)
        There, of all frames.
    """

    point: Array
    sigma: Array
    log_likelihood: float
    rounds: int
    began: Local
    information: Array

    @property
    def scores(self) -> Array:
        """Score of each frame ``(T, p)`` where the last round began."""
        return self.began.scores


@dataclass
class Secants:
    """Moves ``(p,)`` and the changes of the score over them, the last of as many as there are parameters."""

    pairs: list[tuple[Array, Array]] = field(default_factory=list)

    def add(self, before: Local, after: Local) -> None:
        """Add the move from a point to another."""
        self.pairs.append((after.value - before.value, before.gradient - after.gradient))
        del self.pairs[: -len(before.value)]

    def information(self, here: Local) -> Array:
        """Information ``(p, p)`` at a point, that each of the moves has found what it did."""
        found = here.information
        for move, change in self.pairs:
            found = _updated(found, move, change)
        return found


@dataclass(frozen=True)
class Bounds:
    """Of points ``(p,)``.

    Attributes
    ----------
    lowest, largest : (p,)
        Lowest values, minus infinity for none, and largest moves at once.
    """

    lowest: Array
    largest: Array

    def step(self, here: Local, information: Array, needed: BoolArray) -> tuple[Array, float]:
        """Best step ``(p,)`` within the bounds for the quadratic of score and information, and its gain."""
        inside, move = self.inside(here, needed), np.zeros(len(here.value))
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

    def inside(self, here: Local, needed: BoolArray) -> BoolArray:
        """Parameters that are needed, and not held at their lowest value by the score."""
        return needed & ~((here.value <= self.lowest + 1e-9) & (here.gradient < 0.0))


def maximise(
    differentiate: Callable[[Array], Local],
    evaluate: Evaluate,
    start: Array,
    *,
    bounds: Bounds,
    tolerance: float = 0.5,
    most: int = ROUNDS,
    secants: Secants | None = None,
    on_round: Callable[[Round], None] = lambda ended: None,
) -> Maximum:
    """Search the maximum.

    The last move is one that is expected to gain less than the tolerance, or that of the last round allowed;
    its end is evaluated, not differentiated.

    Parameters
    ----------
    differentiate : callable
        Likelihood, scores and information at a point.
    evaluate : callable
    start : (p,)
    bounds : Bounds
    tolerance : float
        Log likelihood that is worth another round. A level whose lowest value costs no more than this goes
        there, and stays.
    most : int
        Rounds, at most.
    secants : Secants, optional
        Those of a search before, of nearly the same likelihood; this one adds to them.
    on_round : callable
        Is given each round that has ended.
    """
    secants = Secants() if secants is None else secants
    here, needed = differentiate(np.maximum(start, bounds.lowest)), np.ones(len(start), bool)
    for number in range(1, most + 1):
        information = secants.information(here)
        move, expected = bounds.step(here, information, needed)
        _log.info("round %d: log likelihood %.1f, expected %.1f", number, here.log_likelihood, expected)
        last = expected < tolerance or number == most
        there = None if last else _better(here, move, differentiate, evaluate, secants)
        if there is not None:
            gain, here = there.log_likelihood - here.log_likelihood, there
            on_round(Round(number, here.value, here.log_likelihood, gain))
            continue
        # Towards its lowest value a level's score fades, so the search stops short of it.
        levels = _dispensable(here.value, bounds, information, most=_MAY_COST * tolerance)
        ends = [here.value + move, here.value + 0.5 * move]
        without = [_at(here.value, index, bounds.lowest[index]) for index in levels]
        values = evaluate([*ends, *without])
        if levels and max(values[2:]) >= here.log_likelihood - tolerance and number < most:
            index = levels[int(np.argmax(values[2:]))]
            needed[index] = False
            here = differentiate(_at(here.value, index, bounds.lowest[index]))
            secants.pairs.clear()
            on_round(Round(number, here.value, here.log_likelihood, 0.0))
            continue
        best = int(np.argmax(values[:2]))
        gain = values[best] - here.log_likelihood
        point = ends[best] if gain > 0.0 else here.value
        reached = here.log_likelihood + max(gain, 0.0)
        on_round(Round(number, point, reached, max(gain, 0.0)))
        break
    sigma = sigma_of(here.scores, here.information, bounds.inside(here, needed))
    return Maximum(point, sigma, reached, number, here, here.information)


def with_curvature(maximum: Maximum, evaluate: Evaluate, spans: Array) -> Maximum:
    """Maximum whose information has the curvature of the likelihood along each parameter.

    The expected information is that of a model that holds. Its correlations are kept, and so is it along a
    parameter by which the likelihood bends upwards.

    Parameters
    ----------
    maximum : Maximum
    evaluate : callable
    spans : (p,)
        How far below, along each parameter, the likelihood is compared with its tangent.
    """
    here = maximum.began
    below = np.array(evaluate(list(here.value - np.diag(spans))))
    curvature = 2.0 * (here.log_likelihood - here.gradient * spans - below) / spans**2
    found = np.isfinite(curvature) & (curvature > 0.0)
    ratio = np.where(found, curvature, 1.0) / np.where(found, np.diagonal(maximum.information), 1.0)
    scale = np.sqrt(ratio)
    information = scale[:, None] * maximum.information * scale
    sigma = sigma_of(here.scores, information, np.isfinite(maximum.sigma))
    return replace(maximum, sigma=sigma, information=information)


def _better(
    here: Local,
    move: Array,
    differentiate: Callable[[Array], Local],
    evaluate: Evaluate,
    secants: Secants,
) -> Local | None:
    """Result of a move, or of a part of it if it gains nothing; None if no part does."""
    there = differentiate(here.value + move)
    if np.isfinite(there.log_likelihood):
        secants.add(here, there)
    if there.log_likelihood > here.log_likelihood:
        return there
    shorter = [here.value + part * move for part in _SHORTER]
    values = evaluate(shorter)
    best = int(np.argmax(values))
    if not values[best] > here.log_likelihood:
        return None
    there = differentiate(shorter[best])
    secants.add(here, there)
    return there


def _dispensable(point: Array, bounds: Bounds, information: Array, *, most: float) -> list[int]:
    """Levels whose lowest value may cost no more than so much.

    A likelihood that is a parabola of the variance, of information J for the logarithm of the level, loses
    J / 8 without it, and one that is flatter towards large variances loses more.
    """
    above = np.isfinite(bounds.lowest) & (point > bounds.lowest + 1e-9)
    return np.flatnonzero(above & (np.diagonal(information) / 8.0 < most)).tolist()


def _at(point: Array, index: int, value: float) -> Array:
    moved = point.copy()
    moved[index] = value
    return moved


def _updated(information: Array, move: Array, change: Array) -> Array:
    """Information that a move has found by how it changed the score, if that is any."""
    expected = information @ move
    if change @ move < _LEAST * (expected @ move):
        return information
    out = information - np.outer(expected, expected) / (expected @ move)
    return np.asarray(out + np.outer(change, change) / (change @ move))


def sigma_of(scores: Array, information: Array, free: BoolArray) -> Array:
    """Standard deviations ``(p,)`` by the sandwich; infinite for parameters that are not free."""
    sigma, inside = np.full(scores.shape[1], np.inf), np.ix_(free, free)
    centred = scores - scores.mean(axis=0)
    inverse = np.linalg.pinv(information[inside])
    sigma[free] = np.sqrt(np.diagonal(inverse @ (centred.T @ centred)[inside] @ inverse))
    return sigma
