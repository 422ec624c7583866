"""Both ways to the maximum: by differences of all frames, and by scores between two rounds of these."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vislam.base.types import Array
from vislam.calibration.parameters import largest_of, lowest_of, point_of
from vislam.calibration.refinement import Bounds, refined
from vislam.calibration.search import Maximum, Round, differences, information_of, maximise, without_tails
from vislam.calibration.target import Point, Target

TOLERANCE = 0.5
"""Gain of log likelihood below which a search has converged, and which a level must be worth."""


def by_differences(target: Target, on_round: Callable[[Round], None]) -> Maximum:
    """Maximum from where a target begins, by two runs a parameter and round."""
    chosen = target.chosen
    return maximise(
        target.evaluate,
        point_of(target.begin, chosen),
        steps=_steps(target),
        lowest=lowest_of(chosen),
        largest=largest_of(chosen),
        tolerance=TOLERANCE,
        on_round=on_round,
    )


def near_maximum(target: Target, on_round: Callable[[Round], None]) -> Array:
    """Point ``(p,)`` to begin a search by differences with: where scores lead from the target's beginning.

    The score holds the points of linearisation. What it lacks by that is found by differences where the
    search begins, and taken to stay what it is.

    Parameters
    ----------
    target : Target
    on_round : callable
        Is given each round that has ended.
    """
    start = best = np.maximum(point_of(target.begin, target.chosen), lowest_of(target.chosen))
    slopes, _, curvature = differences(target.evaluate, start, _steps(target))
    lacks = slopes.sum(axis=0) - target.scored(start).gradient

    def ended(found: Round) -> None:
        nonlocal best
        best = found.point
        on_round(found)

    refined(
        _with(target, lacks),
        start,
        information=information_of(without_tails(slopes), curvature),
        bounds=_bounds(target, np.ones(len(start), bool)),
        tolerance=TOLERANCE,
        on_round=ended,
    )
    return best


def moved_maximum(
    near: Maximum, before: Target, target: Target, on_round: Callable[[Round], None]
) -> Maximum | None:
    """Maximum of a target from that of one that differs by few observations; None where scores find none.

    Intervals and information are those of the other one, and so is which levels are needed.
    """
    lacks = -before.scored(near.point).gradient
    rounds = 0

    def ended(found: Round) -> None:
        nonlocal rounds
        rounds = found.number
        on_round(found)

    found = refined(
        _with(target, lacks),
        near.point,
        information=near.information,
        bounds=_bounds(target, np.isfinite(near.sigma)),
        tolerance=TOLERANCE,
        on_round=ended,
    )
    if found is None:
        return None
    return replace(near, point=found.value, log_likelihood=found.log_likelihood, rounds=rounds)


def _with(target: Target, lacks: Array) -> Callable[[Array], Point]:
    """Points of a target with what its score lacks, evenly over the frames."""

    def scored(value: Array) -> Point:
        found = target.scored(value)
        return replace(found, scores=found.scores + lacks / len(found.scores))

    return scored


def _bounds(target: Target, free: Array) -> Bounds:
    return Bounds(lowest_of(target.chosen), largest_of(target.chosen), free.astype(bool))


def _steps(target: Target) -> Array:
    return np.array([item.step for item in target.chosen])
