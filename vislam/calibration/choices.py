"""The search: choose observations by the gate, maximise, choose again, until both have converged."""

from dataclasses import dataclass

import numpy as np

from vislam.base.errors import DivergedError
from vislam.calibration.likelihood import Evaluator, Gated
from vislam.calibration.match import MATCH_RESTS, MatchingBias, matching_bias, matching_bias_of
from vislam.calibration.parameters import MATCH, Parameter
from vislam.calibration.reporter import CHOICES, Reporter
from vislam.calibration.search import ROUNDS, Maximum, Round, Secants
from vislam.calibration.target import Target
from vislam.comparison.config import Config
from vislam.core.run import Run

_ROUNDS_BEFORE = 2
"""Rounds of a choice that others may follow: it is that of a gate with other noise, whose maximum moves."""
_RESTS = 0.002
"""Share of the observations whose change of side ends the choosing."""


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
    """Choose observations by the gate, maximise, choose again, until both have converged."""
    match = matching_bias(start, evaluator)
    current = MATCH.write(start, match.pixels)
    gated = _finished(evaluator.gated(current))
    secants = Secants()
    for choice in range(1, CHOICES + 1):
        current, usable = MATCH.write(current, match.pixels), ~gated.run.gated
        target = Target(current, chosen, evaluator, usable)

        def ended(found: Round, choice: int = choice, target: Target = target) -> None:
            reporter.round(target.config(found.point), found, choice=choice)

        most = _ROUNDS_BEFORE if choice < CHOICES else ROUNDS
        maximum = target.maximum(most=most, secants=secants, on_round=ended)
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
        match_rests = abs(again.pixels - match.pixels) <= MATCH_RESTS * again.sigma
        rests = changed <= _RESTS * len(usable) and match_rests and maximum.rounds < most
        if rests or choice == CHOICES:
            break
        match = again
    return Searched(current, gated.run, target.with_curvature(maximum), match)


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
