"""What the terminal shows of a study: a row for each point and estimator, and why trials failed."""

import math
import re
from collections import Counter

from vislam.base.legible import one_line
from vislam.comparison import config as configuration
from vislam.evaluation.metric import METRICS
from vislam.study import answers
from vislam.study.intervals import Estimate
from vislam.study.page.labels import position_error
from vislam.study.trials import Trials

_MOST_REASONS = 5
_LONGEST_REASON = 300


def header(trials: Trials) -> tuple[str, ...]:
    """Titles of the columns."""
    return (
        *("point", "estimator", "trials", "failed"),
        *(position_error(trials).short_label, "95 % interval"),
        *(METRICS[answers.NEES].short_title, "95 % interval"),
    )


def rows_of(trials: Trials) -> list[tuple[str, ...]]:
    """How many trials, how many without the estimator's answer, its mean error and its NEES.

    The NEES per degree of freedom is 1 if the estimator is consistent.
    """
    found: list[tuple[str, ...]] = []
    for point, rows in trials.groups():
        told = ", ".join(f"{path} {configuration.inline(value)}" for path, value in point.items()) or "-"
        for name, complete in trials.complete.items():
            error = answers.mean(trials, name, position_error(trials).key, rows=rows)
            nees = answers.pooled_nees(trials, name, rows=rows)
            missing = str(int((~complete[rows]).sum()))
            cells = (*_cells(error), *_cells(None if nees is None else nees.mean))
            found.append((told, name, str(len(rows)), missing, *cells))
    return found


def reasons_of(trials: Trials) -> list[str]:
    """How many trials failed, or have runs that did, for which reason, the most frequent first.

    Reasons that differ in their numbers only, such as that of the frame, count as one; the first is shown.
    """
    failed = [reason for reason in trials.reason if reason]
    kinds = [re.sub(r"\d[\d.]*", "0", reason) for reason in failed]
    shown = dict(zip(reversed(kinds), reversed(failed), strict=True))
    counts = Counter(kinds).most_common()
    told = [
        f"{count} of {len(trials)} trials: {reason_line(shown[kind])}"
        for kind, count in counts[:_MOST_REASONS]
    ]
    if rest := counts[_MOST_REASONS:]:
        told.append(f"{sum(count for _, count in rest)} of {len(trials)} trials: {len(rest)} other reasons")
    return told


def reason_line(reason: str) -> str:
    """Why a trial has failed, in one line."""
    return one_line(reason, limit=_LONGEST_REASON)


def _cells(found: Estimate | None) -> tuple[str, str]:
    if found is None:
        return "-", "-"
    known = math.isfinite(found.low)
    return f"{found.value:.3f}", f"{found.low:.3f} to {found.high:.3f}" if known else "-"
