"""What each rung of a ladder of estimators adds, and what that does to the error."""

from collections.abc import Mapping
from dataclasses import dataclass

from vislam.core.reference import Reference
from vislam.core.run import ESTIMATES, Run
from vislam.evaluation.evaluate import Evaluation, headline


@dataclass(frozen=True)
class Rung:
    """One run on the ladder, against the one below it, the same estimate of both.

    All are differences on one recording. They have a sign: a rung may make it worse.

    Attributes
    ----------
    run : str
    adds : str
        What it adds to the rung below.
    key : str
        The metric that is the error.
    filtered, smoothed : float or None
        Error of the filtered and of the smoothed poses [m]; None for an incomplete run, or where it has none.
    filtered_change, smoothed_change : float or None
        The same less that of the rung below [m], negative where this is better; None if either is missing.
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
        filtered, smoothed = (
            evaluation.value(name, key, estimate) if complete else None for estimate in ESTIMATES
        )
        below = (rungs[-1].filtered, rungs[-1].smoothed) if rungs else (None, None)
        changes = _less(filtered, below[0]), _less(smoothed, below[1])
        rungs.append(Rung(name, adds, key, filtered, smoothed, *changes, _less(smoothed, filtered)))
    return rungs


def _less(one: float | None, other: float | None) -> float | None:
    return None if one is None or other is None else one - other
