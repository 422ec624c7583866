"""What each rung of a ladder of estimators adds, and what that does to the error."""

from collections.abc import Mapping
from dataclasses import dataclass

from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.evaluation.evaluate import Evaluation, headline


@dataclass(frozen=True)
class Rung:
    """One run on the ladder, against the one below it.

    All are differences on one recording. They have a sign: a rung may make it worse.

    Attributes
    ----------
    run : str
    adds : str
        What it adds to the rung below.
    key : str
        The metric that is the error.
    error, causal : float or None
        Of the poses as known in the end, and as known at their own time [m]; None for an incomplete run.
    change : float or None
        ``error`` less that of the rung below [m], negative where this is better; None if either is missing.
    causal_less_final : float or None
        ``causal`` less ``error`` [m]: what knowing the rest of the drive did within this run.
    """

    run: str
    adds: str
    key: str
    error: float | None
    causal: float | None
    change: float | None
    causal_less_final: float | None


def attribute(
    ladder: Mapping[str, str], runs: Mapping[str, Run], evaluation: Evaluation, reference: Reference | None
) -> list[Rung]:
    """Rungs of a ladder, from below.

    Parameters
    ----------
    ladder : mapping of str to str
        What each run adds to the one before it, by the name of the run.
    runs : mapping of name to Run
    evaluation : Evaluation
        Of these runs.
    reference : Reference or None
        None: nobody knows the errors, and there are no rungs.
    """
    if reference is None:
        return []
    key = headline(reference)
    rungs: list[Rung] = []
    for name, adds in ladder.items():
        # An incomplete run is scored on the frames it finished, which are not those of its neighbours.
        complete = runs[name].complete
        error = evaluation.value(name, key) if complete else None
        causal = evaluation.value(name, f"{key}_causal") if complete else None
        below = rungs[-1].error if rungs else None
        rungs.append(Rung(name, adds, key, error, causal, _less(error, below), _less(causal, error)))
    return rungs


def _less(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else one - other
