"""The search: choose observations by the gate, maximise, choose again, until both have converged."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from vislam.base.errors import DivergedError
from vislam.calibration.likelihood import Evaluator, Gated
from vislam.calibration.match import MatchingBias, matching_bias, matching_bias_of
from vislam.calibration.maxima import by_differences, moved_maximum, near_maximum
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

    A round of differences takes two runs a parameter, so scores lead from the first to the last of them.
    """
    match = matching_bias(start, evaluator)
    current = MATCH.write(start, match.pixels)
    gated = _finished(evaluator.gated(current))
    near: tuple[Maximum, Target] | None = None
    for choice in range(1, CHOICES + 1):
        current, usable = MATCH.write(current, match.pixels), ~gated.run.gated
        target = Target(current, chosen, evaluator, usable, gated.halves)

        def ended(by: str, found: Round, choice: int = choice, target: Target = target) -> None:
            reporter.round(target.config(found.point), found, choice=choice, by=by)

        moved = None if near is None else moved_maximum(*near, target, partial(ended, "scores"))
        maximum = _from_the_beginning(target, ended) if moved is None else moved
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
        match, near = again, (maximum, target)
    return Searched(current, gated.run, maximum, match)


def _from_the_beginning(target: Target, ended: Callable[[str, Round], None]) -> Maximum:
    begin = target.config(near_maximum(target, partial(ended, "scores")))
    return by_differences(replace(target, begin=begin), partial(ended, "differences"))


def work_of(start: Config, chosen: list[Parameter], evaluator: Evaluator) -> Work:
    """Work that a calibration takes as a rule that begins with this config."""
    target = Target(start, chosen, evaluator, np.empty(0, bool))
    return Work.of(len(chosen), others=len(target.others(point_of(start, chosen))))


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
