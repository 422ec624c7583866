"""Ablation chain: what each step adds to the one before it, and the change of the error."""

from collections.abc import Mapping
from dataclasses import dataclass

from vislam.core.reference import Reference
from vislam.core.run import ESTIMATES, Run
from vislam.evaluation.evaluate import Evaluation, headline


@dataclass(frozen=True)
class AblationStep:
    """One run of an ablation chain against the one before it, the same estimate of both.

    All are differences on one recording, with their sign: a step may increase the error.

    Attributes
    ----------
    run : str
    adds : str
        What it adds to the step before it.
    key : str
        The metric that is the error.
    filtered, smoothed : float or None
        Error of the filtered and of the smoothed poses [m]; None for an incomplete run, or where it has none.
    filtered_change, smoothed_change : float or None
        The same less that of the step before it [m], negative where this is better; None if either is
        missing.
    smoothing : float or None
        ``smoothed`` less ``filtered`` [m]: what the data after each frame did within this run.
    """

    run: str
    adds: str
    key: str
    filtered: float | None
    smoothed: float | None
    filtered_change: float | None
    smoothed_change: float | None
    smoothing: float | None


def attribute(
    chain: Mapping[str, str], runs: Mapping[str, Run], evaluation: Evaluation, reference: Reference | None
) -> list[AblationStep]:
    """Rungs of a chain, from before.

    Parameters
    ----------
    chain : mapping of str to str
        What each run adds to the one before it, by the name of the run.
    runs : mapping of name to Run
    evaluation : Evaluation
        Of these runs.
    reference : Reference or None
        None: the errors are unknown, and there are no steps.
    """
    if reference is None:
        return []
    key = headline(reference)
    steps: list[AblationStep] = []
    for name, adds in chain.items():
        # An incomplete run is scored on the frames it finished, which are not those of its neighbours.
        complete = runs[name].complete
        filtered, smoothed = (
            evaluation.value(name, key, estimate) if complete else None for estimate in ESTIMATES
        )
        before = (steps[-1].filtered, steps[-1].smoothed) if steps else (None, None)
        changes = _less(filtered, before[0]), _less(smoothed, before[1])
        steps.append(AblationStep(name, adds, key, filtered, smoothed, *changes, _less(smoothed, filtered)))
    return steps


def _less(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else one - other
