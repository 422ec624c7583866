"""The search: choose observations by the gate, maximise, choose again, until both have converged."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from vislam.base.errors import DivergedError
from vislam.calibration.likelihood import Evaluator, Gated
from vislam.calibration.match import MOST_ITERATIONS, MatchingBias, matching_bias, matching_bias_of
from vislam.calibration.maxima import by_differences, by_scores
from vislam.calibration.parameters import MATCH, Parameter, point_of
from vislam.calibration.reporter import CHOICES, Reporter, Work
from vislam.calibration.search import Maximum, Round
from vislam.calibration.target import Target
from vislam.comparison.config import Config
from vislam.core.run import Run

_RESTS = 0.002
"""Share of the observations whose change of side ends the choosing."""
_MATCH_RESTS = 0.5
"""Change of the match level, in its standard deviations, that ends it."""


@dataclass(frozen=True)
class Searched:
    """Where the search ended.

    Attributes
    ----------
    config : Config
    run : Run
        The gated filter with it.
    maximum : Maximum
    match : MatchingBias
    """

    config: Config
    run: Run
    maximum: Maximum
    match: MatchingBias


def search(start: Config, chosen: list[Parameter], evaluator: Evaluator, reporter: Reporter) -> Searched:
    """Choose observations by the gate, maximise, choose again, until both have converged.

    A long recording is searched by scores. Where these do not lead to a maximum, and on a short one, it is by
    differences.
    """
    scores = not evaluator.stands_alone
    match = matching_bias(start, evaluator, most=1 if scores else MOST_ITERATIONS)
    current = MATCH.write(start, match.pixels)
    near: Maximum | None = None
    gated = _finished(evaluator.gated(current))
    for choice in range(1, CHOICES + 1):
        current, usable = MATCH.write(current, match.pixels), ~gated.run.gated
        target = Target(current, chosen, evaluator, usable)

        def ended(found: Round, choice: int = choice, target: Target = target) -> None:
            reporter.round(target.config(found.point), found, choice=choice)

        maximum = _maximum(target, gated, ended, near=near) if scores else by_differences(target, ended)
        current = target.config(maximum.point)
        gated = _finished(evaluator.gated(current))
        changed = int(np.sum(gated.run.gated == usable))
        reporter.say(
            f"choice {choice} of observations: {maximum.rounds} rounds, log likelihood "
            f"{maximum.log_likelihood:.1f}, NIS per degree of freedom {gated.run.nis_per_dof:.3f}, "
            f"{changed} observations changed sides"
        )
        # The level of the match was read off with the noise from before this choice.
        again = matching_bias_of(current, evaluator, gated)
        match_rests = abs(again.pixels - match.pixels) <= _MATCH_RESTS * again.sigma
        if (changed <= _RESTS * len(usable) and match_rests) or choice == CHOICES:
            break
        match, near = again, maximum
    return Searched(current, gated.run, maximum, match)


def _maximum(
    target: Target, gated: Gated, ended: Callable[[Round], None], *, near: Maximum | None
) -> Maximum:
    """Maximum by scores; by differences from where these have led, if they do not lead there."""
    best = point_of(target.begin, target.chosen)

    def led(found: Round) -> None:
        nonlocal best
        best = found.point
        ended(found)

    whole, stretches = (replace(target, stretches=part) for part in (gated.halves, gated.stretches))
    found = by_scores(whole, stretches, led, near=near)
    return by_differences(replace(target, begin=target.config(best)), ended) if found is None else found


def work_of(start: Config, chosen: list[Parameter], evaluator: Evaluator) -> Work:
    """Work that a calibration takes as a rule that begins with this config."""
    if evaluator.stands_alone:
        return Work.by_differences(len(chosen))
    target = Target(start, chosen, evaluator, np.empty(0, bool))
    return Work.by_scores(len(chosen), others=len(target.others(point_of(start, chosen))))


def finished(run: Run) -> Run:
    """Return the run, which has come to its end.

    Raises
    ------
    DivergedError
        If it has not.
    """
    if not run.complete:
        raise DivergedError(f"the filter did not finish, so there is no likelihood: {run.log.error}")
    return run


def _finished(gated: Gated) -> Gated:
    finished(gated.run)
    return gated
