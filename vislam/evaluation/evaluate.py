"""Runs scored, one by one and in pairs: the scores, the metrics and the statistics, with look-up."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations

import numpy as np

from vislam.core.record import Record
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.evaluation import metrics
from vislam.evaluation.maps import Bin
from vislam.evaluation.metrics import Metric
from vislam.evaluation.scores import PairScores, RunScores, score_pair, score_run
from vislam.evaluation.statistics import Statistic

_FEWEST = 2
"""Poses without which there is nothing to score."""


@dataclass(frozen=True)
class Evaluation:
    """All that is said of some runs.

    Attributes
    ----------
    metrics : sequence of Metric
    statistics : dict of (str, str) to Statistic
        By run and name.
    scores : dict of str to RunScores
        By run.
    pairs : dict of (str, str) to PairScores
        By the runs, in their order.
    """

    metrics: Sequence[Metric]
    statistics: Mapping[tuple[str, str], Statistic] = field(default_factory=dict)
    scores: Mapping[str, RunScores] = field(default_factory=dict)
    pairs: Mapping[tuple[str, str], PairScores] = field(default_factory=dict)

    def value(self, estimator: str, key: str) -> float | None:
        """Value of a metric, or None where it does not exist."""
        return next((m.value for m in self.metrics if (m.estimator, m.key) == (estimator, key)), None)

    def statistic(self, estimator: str, name: str) -> Statistic | None:
        """Look a statistic up; None where it does not exist."""
        return self.statistics.get((estimator, name))

    def degenerate(self, name: str) -> tuple[str, ...]:
        """Why a run is no answer to the data; empty for a sound one."""
        return self.scores[name].degenerate if name in self.scores else ()

    def records(self) -> list[dict[str, object]]:
        """Metrics as plain data for JSON."""
        return [asdict(metric) for metric in self.metrics]

    def statistic_records(self) -> list[dict[str, object]]:
        """Statistics as plain data for JSON, with their 95 % intervals."""
        found = []
        for (estimator, name), statistic in self.statistics.items():
            low, high = statistic.interval(0.95)
            interval = {"low_95": low, "high_95": high, "p_value": statistic.p_value()}
            found.append({"estimator": estimator, **asdict(statistic), "name": name, **interval})
        return found

    def worst_segments(self) -> dict[str, list[dict[str, object]]]:
        """Where each run errs most, as plain data for JSON."""
        return {
            name: [asdict(segment) for segment in one.final.worst]
            for name, one in self.scores.items()
            if one.final is not None
        }

    def map_agreement(self) -> dict[str, dict[str, list[dict[str, object]]]]:
        """Landmark by landmark between two runs, by depth and by views, as plain data for JSON."""
        return {
            "|".join(pair): {
                "by_depth": [_plain(row) for row in one.by_depth()],
                "by_views": [_plain(row) for row in one.by_views()],
            }
            for pair, one in self.pairs.items()
            if one.map is not None
        }


def _plain(row: Bin) -> dict[str, object]:
    """Plain data in which what is no number is null."""
    return {key: value if np.isfinite(value) else None for key, value in asdict(row).items()}


def headline(reference: Reference) -> str:
    """Key of the error that says how right a run is: the ATE, planar where the reference is [m]."""
    return "ate_planar_rmse" if reference.planar else "ate_rmse"


def evaluate(runs: Mapping[str, Run], record: Record) -> Evaluation:
    """Score runs, in their order.

    Parameters
    ----------
    runs : mapping of name to Run
        Incomplete runs are scored on the frames they finished.
    record : Record
        Of the drive behind them.
    """
    against = "" if record.reference is None else record.reference.name
    scores = {name: score_run(run, record) for name, run in runs.items() if len(run.stamp) >= _FEWEST}
    pairs = {(a, b): score_pair(scores[a], scores[b], record) for a, b in combinations(scores, 2)}
    found = [metric for one in scores.values() for metric in metrics.of_run(one, against)]
    for (a, b), pair in pairs.items():
        found += metrics.of_pair(scores[a], scores[b], pair)
    return Evaluation(
        metrics=[metric for metric in found if np.isfinite(metric.value)],
        statistics={
            (name, key): statistic
            for name, one in scores.items()
            for key, statistic in one.statistics.items()
            if np.isfinite(statistic.value)
        },
        scores=scores,
        pairs=pairs,
    )
