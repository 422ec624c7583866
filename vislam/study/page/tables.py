"""The tables of a study: a row for each point and estimator."""

import itertools
from collections.abc import Iterator

import numpy as np

from vislam.base.types import IntArray
from vislam.evaluation.metric import METRICS
from vislam.report.table import Table
from vislam.study.answers import (
    NEES,
    failure_rate,
    mean,
    median,
    paired,
    pooled_coverage,
    pooled_nees,
    rank_correlation,
)
from vislam.study.page.labels import (
    ERRORS,
    TIME,
    errors,
    metric_label,
    parameter_label,
    percent,
    plain,
    with_interval,
)
from vislam.study.settings import Ranking
from vislam.study.trials import Trials

CLAIMS = {"nis_per_dof": mean, "spurious_yaw_information": median}
"""What else speaks for consistency, and what is shown of it over trials: a gain may span decades."""


def failures_table(trials: Trials) -> Table:
    """How many runs were carried out and how many of them did not finish."""
    rows = []
    for cells, name, at in _rows(trials):
        rate = failure_rate(trials, name, rows=at)
        done = int(np.count_nonzero(trials.done[at]))
        failed = int(np.count_nonzero(trials.done[at] & ~trials.complete[name][at]))
        rows.append([name, *cells, str(len(at)), str(len(at) - done), str(failed), percent(rate)])
    header = ["trials", "failed as a whole", "failed runs", "failure rate"]
    return Table([*_header(trials), *header], rows)


def errors_table(trials: Trials) -> Table:
    """Median of each error and of the time of a step, and the mean of the headline error."""
    keys = errors(trials)
    rows = []
    for cells, name, at in _rows(trials):
        medians = [median(trials, name, key, rows=at) for key in (*keys, TIME)]
        first = mean(trials, name, keys[0], rows=at) if keys else None
        told = [with_interval(first) if keys else "-", *map(with_interval, medians)]
        rows.append([name, *cells, str(first.count if first else 0), *told])
    header = ["trials with it", f"mean {metric_label(keys[0])}" if keys else "mean error"]
    header += [*(f"median {metric_label(key)}" for key in keys), f"median {metric_label(TIME)}"]
    return Table([*_header(trials), *header], rows)


def consistency_table(trials: Trials) -> Table:
    """NEES and coverage over trials, where some trial has them, and what else speaks for consistency."""
    keys = [key for key in CLAIMS if trials.has(key)]
    rows = []
    for cells, name, at in _rows(trials):
        nees, coverage = pooled_nees(trials, name, rows=at), pooled_coverage(trials, name, rows=at)
        if nees is not None:
            told = [str(nees.mean.count), str(nees.mean.missing), with_interval(nees.mean)]
            told += [percent(nees.beyond), percent(coverage)]
            others = [with_interval(CLAIMS[key](trials, name, key, rows=at)) for key in keys]
            rows.append([name, *cells, *told, *others])
    header = ["trials", "missing", METRICS[NEES].title, "trials beyond the bound"]
    header += ["errors within 3 sigma", *map(metric_label, keys)]
    return Table([*_header(trials), *header], rows)


def pairs_table(trials: Trials) -> Table:
    """Each two estimators on the same trials, by the headline error."""
    keys = errors(trials)[:1]
    rows = []
    for key in keys:
        for (point, at), (one, other) in itertools.product(
            trials.groups(), itertools.combinations(trials.complete, 2)
        ):
            found = paired(trials, one, other, key, rows=at)
            if found is not None:
                told = [str(found.difference.count), str(found.difference.missing)]
                told += [with_interval(found.difference), percent(found.better), f"{found.p_value:.2g}"]
                rows.append([f"{one} less {other}", *map(plain, point.values()), *told])
    unit = ERRORS[keys[0]].unit if keys else ""
    header = ["trials of both", "missing", f"mean difference [{unit}]", "first is better", "p"]
    return Table(["estimators", *map(parameter_label, trials.point), *header], rows)


def ranking_table(trials: Trials, ranking: Ranking) -> Table:
    """How far each error ranks the runs of a seed as a metric does."""
    rows = []
    trials = trials if ranking.estimate is None else trials.of(ranking.estimate)
    for key in ranking.errors:
        found = rank_correlation(trials, ranking.by, key)
        rows.append([metric_label(key), str(found.count if found else 0), with_interval(found)])
    return Table(["error", "seeds", f"rank correlation with {metric_label(ranking.by)}"], rows)


def failed_table(trials: Trials) -> Table:
    """Trials of which something failed, with the reason."""
    rows = [
        [str(trials.seed[row]), *(plain(values[row]) for values in trials.point.values()), reason]
        for row, reason in enumerate(trials.reason)
        if reason
    ]
    return Table(["seed", *map(parameter_label, trials.point), "reason"], rows)


def _header(trials: Trials) -> list[str]:
    return ["estimator", *map(parameter_label, trials.point)]


def _rows(trials: Trials) -> Iterator[tuple[list[str], str, IntArray]]:
    """Cells of the swept parameters, estimator and rows of each row of a table."""
    for point, rows in trials.groups():
        for name in trials.complete:
            yield [plain(value) for value in point.values()], name, rows
