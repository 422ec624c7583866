"""What the terminal shows of a study: a row for each point and estimator."""

from vislam import config as configuration
from vislam.study import answers
from vislam.study.intervals import Estimate
from vislam.study.trials import Trials

HEADER = ("point", "estimator", "trials", "failed", "ATE [m]", "95 % interval", "NEES pose", "95 % interval")
_ERROR = "ate_rmse"


def rows_of(trials: Trials) -> list[tuple[str, ...]]:
    """How many trials, how many without the estimator's answer, its mean error and its NEES.

    The NEES per degree of freedom is 1 if the estimator is consistent.
    """
    found: list[tuple[str, ...]] = []
    for point, rows in trials.groups():
        told = ", ".join(f"{path} {configuration.inline(value)}" for path, value in point.items()) or "-"
        for name, complete in trials.complete.items():
            error = answers.mean(trials, name, _ERROR, rows=rows)
            nees = answers.pooled_nees(trials, name, rows=rows)
            missing = str(int((~complete[rows]).sum()))
            cells = (*_cells(error), *_cells(None if nees is None else nees.mean))
            found.append((told, name, str(len(rows)), missing, *cells))
    return found


def _cells(found: Estimate | None) -> tuple[str, str]:
    return ("-", "-") if found is None else (f"{found.value:.3f}", f"{found.low:.3f} to {found.high:.3f}")
