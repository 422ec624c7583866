"""Maximum of a likelihood that is a sum over frames, by finite differences of few points.

Two runs a parameter give the score of each frame and the curvature along that parameter. The curvatures and
the correlations of the scores make up the information, and Newton's step with it is damped as far as needed.
The standard deviations are those of the sandwich (Huber 1967; White 1982), which hold where the model does
not.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray

Evaluate = Callable[[list[Array]], list[Array]]
"""From points ``(p,)`` to log likelihoods of each frame ``(T,)``."""

_log = logging.getLogger("vislam.calibration")
ROUNDS = 12
"""Rounds of a search, at most."""
_DAMPING = (0.0, 0.3, 3.0)
_TAIL = 3.0 * 1.4826
"""Median absolute deviations of a normal distribution that are three standard deviations."""
_SHARE = 0.5
"""Share of the expected gain from which on a step is taken without a look at others."""


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
    scores : (T, p)
        Score of each frame where the last round began.
    information : (p, p)
        There, of all frames.
    """

    point: Array
    sigma: Array
    log_likelihood: float
    rounds: int
    scores: Array
    information: Array


def maximise(
    evaluate: Evaluate,
    start: Array,
    *,
    steps: Array,
    lowest: Array,
    largest: Array,
    tolerance: float = 0.5,
    on_round: Callable[[Round], None] = lambda ended: None,
) -> Maximum:
    """Search the maximum.

    Parameters
    ----------
    evaluate : callable
    start : (p,)
    steps : (p,)
        Half of each finite difference.
    lowest : (p,)
        Bounds; -inf for none.
    largest : (p,)
        Largest move of a parameter in one round.
    tolerance : float
        The search ends when a round gains less log likelihood than this; a parameter whose lowest value costs
        no more than this goes there, and stays.
    on_round : callable
        Is given each round when it has ended.
    """
    point, needed = np.maximum(start, lowest), np.ones(len(start), bool)
    for rounds in range(1, ROUNDS + 1):
        scores, here, curvature = differences(evaluate, point, steps)
        free = needed & ~((point <= lowest + 1e-9) & (scores.sum(axis=0) < 0.0))
        candidates = [
            np.maximum(point + np.clip(move, -largest, largest), lowest)
            for move in _moves(scores, curvature, free)
        ]
        # Newton's own step, and the damped ones only where it gains less than half of what it should.
        move = candidates[0] - point
        values, should = [float(evaluate(candidates[:1])[0].sum())], _expected(move, scores, curvature)
        at_maximum = 0.0 <= should < tolerance and bool((np.abs(move) < largest).all())
        if not (at_maximum or values[0] - here >= max(_SHARE * should, 0.0)):
            values += [float(part.sum()) for part in evaluate(candidates[1:])]
        choice = int(np.argmax(values))
        gain = values[choice] - here
        _log.info("round %d: log likelihood %.1f, gain %.1f, at %s", rounds, here, gain, np.round(point, 3))
        if gain > 0.0:
            point, here = candidates[choice], values[choice]
        rests, index = gain < tolerance, None
        if rests:
            # Towards its lowest value a level's score fades, so the search comes to rest short of it.
            without = without_each(evaluate, point, lowest, here=here)
            index = int(np.argmin(without)) if (without <= tolerance).any() else None
        if index is not None:
            point, needed[index], free[index] = point.copy(), False, False
            point[index], here = lowest[index], here - without[index]
        on_round(Round(rounds, point, here, max(gain, 0.0)))
        if rests and index is None:
            break
    sigma = sigma_of(scores, curvature, free)
    return Maximum(point, sigma, here, rounds, scores, information_of(scores, curvature))


def differences(evaluate: Evaluate, point: Array, steps: Array) -> tuple[Array, float, Array]:
    """Scores ``(T, p)`` and curvatures ``(p,)`` by central differences, and the likelihood at the point."""
    points = [point]
    for index in range(len(point)):
        for sign in (1.0, -1.0):
            moved = point.copy()
            moved[index] += sign * steps[index]
            points.append(moved)
    values = evaluate(points)
    here, above, below = values[0], values[1::2], values[2::2]
    slopes = [(up - down) / (2.0 * step) for up, down, step in zip(above, below, steps, strict=True)]
    bends = [
        (2.0 * here - up - down).sum() / step**2 for up, down, step in zip(above, below, steps, strict=True)
    ]
    scores = np.nan_to_num(np.column_stack(slopes), posinf=0.0, neginf=0.0)
    return scores, float(here.sum()), np.nan_to_num(np.array(bends), posinf=0.0, neginf=0.0)


def without_each(evaluate: Evaluate, point: Array, lowest: Array, *, here: float) -> Array:
    """Log likelihood ``(p,)`` that each level costs at its lowest value; infinite where it is there.

    Parameters
    ----------
    evaluate : callable
    point, lowest : (p,)
        A lowest value of minus infinity is that of an offset, or of a level that is not asked for.
    here : float
        Log likelihood at the point.
    """
    lost = np.full(len(point), np.inf)
    above = np.flatnonzero(point > np.where(np.isfinite(lowest), lowest + 1e-9, np.inf))
    if len(above):
        candidates = np.tile(point, (len(above), 1))
        candidates[np.arange(len(above)), above] = lowest[above]
        lost[above] = [here - float(part.sum()) for part in evaluate(list(candidates))]
    return lost


def _moves(scores: Array, curvature: Array, free: BoolArray) -> list[Array]:
    """Steps to try: Newton's with more and more damping."""
    gradient, information = scores.sum(axis=0), information_of(scores, curvature)
    moves = []
    for damping in _DAMPING:
        move = np.zeros(len(gradient))
        inside = information[np.ix_(free, free)]
        damped = inside + np.diag((damping + 1e-9) * np.diagonal(inside))
        move[free] = np.linalg.solve(damped, gradient[free])
        moves.append(move)
    return moves


def _expected(move: Array, scores: Array, curvature: Array) -> float:
    """Gain of a move by the quadratic of gradient and information."""
    return float(scores.sum(axis=0) @ move - 0.5 * move @ information_of(scores, curvature) @ move)


def _spread(scores: Array) -> Array:
    """Sum of the outer products of the scores about their mean."""
    centred = scores - scores.mean(axis=0)
    return centred.T @ centred + 1e-12 * np.eye(scores.shape[1])


def information_of(scores: Array, curvature: Array) -> Array:
    """Information ``(p, p)``: curvatures on the diagonal, correlated as the scores are.

    Where the likelihood bends upwards, the curvature is that of the scores.
    """
    spread = _spread(scores)
    variance = np.diagonal(spread)
    scale = np.sqrt(np.where(curvature > 0.0, curvature, variance) / variance)
    return np.asarray(scale[:, None] * spread * scale)


def without_tails(scores: Array) -> Array:
    """Scores ``(T, p)`` that are no farther from their median than three of their usual deviations.

    Correlations of few frames with heavy tails are those of the frame that is farthest off.
    """
    away = scores - np.median(scores, axis=0)
    most = _TAIL * np.median(np.abs(away), axis=0)
    return np.where(most > 0.0, np.clip(away, -most, most), away)


def sigma_of(scores: Array, curvature: Array, free: BoolArray) -> Array:
    """Standard deviations ``(p,)`` by the sandwich; infinite for parameters that are not free."""
    sigma = np.full(scores.shape[1], np.inf)
    inside = np.ix_(free, free)
    inverse = np.linalg.pinv(information_of(scores, curvature)[inside])
    sigma[free] = np.sqrt(np.diagonal(inverse @ _spread(scores)[inside] @ inverse))
    return sigma
