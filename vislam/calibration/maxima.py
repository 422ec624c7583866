"""Both ways to the maximum: by differences of all frames, and by scores."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vislam.base.types import Array
from vislam.calibration.parameters import largest_of, lowest_of, point_of
from vislam.calibration.refinement import Bounds, refined
from vislam.calibration.search import (
    Maximum,
    Round,
    differences,
    information_of,
    maximise,
    sigma_of,
    without_each,
    without_tails,
)
from vislam.calibration.target import Target

TOLERANCE = 0.5
"""Gain of log likelihood below which a search has converged, and which a level must be worth."""
_CERTAIN = 0.2
"""Standard deviation of a level's logarithm up to which the data do need it: that of twelve errors of it."""


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


def by_scores(
    whole: Target, stretches: Target, on_round: Callable[[Round], None], *, near: Maximum | None = None
) -> Maximum | None:
    """Maximum of the whole by its exact score; None where none is found.

    How far to go, and the intervals, are by the information of stretches, in proportion to the frames.

    Parameters
    ----------
    whole, stretches : Target
        The whole, and stretches of it with the same beginning.
    on_round : callable
        Is given each round that has ended.
    near : Maximum or None
        That of other observations, whose information and intervals are taken, and which levels are needed.
    """
    lowest, steps = lowest_of(whole.chosen), _steps(whole)
    start = np.maximum(point_of(whole.begin, whole.chosen), lowest)
    frames = sum(one.end - one.counted for one in stretches.stretches)
    share = frames / len(whole.evaluator.dataset.sequence)
    free = np.ones(len(start), bool) if near is None else np.isfinite(near.sigma)
    bounds, rounds = Bounds(lowest, largest_of(whole.chosen), free), 0

    def bends(point: Array) -> tuple[Array, Array, Array]:
        """Scores, curvature and information of the stretches, the last in proportion to the frames."""
        scores, _, curvature = differences(stretches.evaluate, point, steps)
        return scores, curvature, information_of(without_tails(scores), curvature) / share

    information = bends(start)[2] if near is None else near.information

    def ended(found: Round) -> None:
        nonlocal rounds
        rounds += 1
        on_round(replace(found, number=rounds))

    while True:
        here = refined(
            whole.scored, start, information=information, bounds=bounds, tolerance=TOLERANCE, on_round=ended
        )
        if here is None:
            return None
        if near is not None:
            return replace(
                near,
                point=here.value,
                log_likelihood=here.log_likelihood,
                rounds=rounds,
                scores=here.scores,
            )
        scores, curvature, information = bends(here.value)
        free = bounds.inside(here)
        sigma = sigma_of(scores, curvature, free) * np.sqrt(share)
        doubtful = np.where(free & (sigma > _CERTAIN), lowest, -np.inf)
        lost = without_each(whole.evaluate, here.value, doubtful, here=here.log_likelihood)
        if not (lost <= TOLERANCE).any():
            break
        index = int(np.argmin(lost))
        start, bounds.free[index] = here.value.copy(), False
        start[index] = lowest[index]
    return Maximum(here.value, sigma, here.log_likelihood, rounds, here.scores, information)


def _steps(target: Target) -> Array:
    return np.array([item.step for item in target.chosen])
