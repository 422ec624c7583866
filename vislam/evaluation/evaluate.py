"""Runs scored, one by one and in pairs: the scores, the metrics and the statistics, with look-up."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import chain, combinations

import numpy as np

from vislam.core.own_clock import OwnClock
from vislam.core.record import Record
from vislam.core.reference import Reference
from vislam.core.run import Estimate, Run
from vislam.evaluation import metrics
from vislam.evaluation.information import shared_information
from vislam.evaluation.lookup import Entry, Lookup
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
    statistics : dict of Entry to Statistic
        By run, name and estimate.
    scores : dict of str to RunScores
        By run.
    pairs : dict of (str, str) to PairScores
        By the runs, in their order.
    """

    metrics: Sequence[Metric]
    statistics: Mapping[Entry, Statistic] = field(default_factory=dict)
    scores: Mapping[str, RunScores] = field(default_factory=dict)
    pairs: Mapping[tuple[str, str], PairScores] = field(default_factory=dict)

    @cached_property
    def _metrics(self) -> Lookup[Metric]:
        return Lookup({(m.estimator, m.key, m.estimate): m for m in self.metrics})

    def metric(self, estimator: str, key: str, estimate: Estimate | None = None) -> Metric | None:
        """Look a metric up, by default that of the final estimate; None where it does not exist."""
        return self._metrics.find(estimator, key, estimate)

    def value(self, estimator: str, key: str, estimate: Estimate | None = None) -> float | None:
        """Value of a metric, by default that of the final estimate, or None where it does not exist."""
        found = self.metric(estimator, key, estimate)
        return None if found is None else found.value

    def statistic(self, estimator: str, name: str, estimate: Estimate | None = None) -> Statistic | None:
        """Look a statistic up, by default that of the final estimate; None where it does not exist."""
        chosen = self.final(estimator) if estimate is None else estimate
        return Lookup(self.statistics).find(estimator, name, chosen)

    def final(self, estimator: str) -> Estimate:
        """Final estimate of a run, or the last that two share: what is meant where none is named."""
        return self._metrics.final(estimator)

    def keys(self, estimator: str, estimate: Estimate | None = None) -> list[str]:
        """Keys of the metrics that a run, or two, has of an estimate, by default of the final one."""
        found = {metric.key for metric in self.metrics if metric.estimator == estimator}
        return sorted(key for key in found if self.metric(estimator, key, estimate) is not None)

    def estimates(self, name: str) -> tuple[Estimate, ...]:
        """Estimates of a run that are scored, the final one last; none of a run that is too short."""
        return tuple(self.scores[name].estimates) if name in self.scores else ()

    def degenerate(self, name: str, estimate: Estimate | None = None) -> tuple[str, ...]:
        """Why an estimate of a run, by default the final one, is no answer to the data; empty if sound."""
        if name not in self.scores:
            return ()
        scores = self.scores[name]
        found = scores.final if estimate is None else scores.estimates.get(estimate)
        return () if found is None else found.degenerate

    def noticed(self) -> dict[str, tuple[str, ...]]:
        """Conventions that would fool the scores, by the run from elsewhere that has them."""
        return {
            name: one.own.noticed
            for name, one in self.scores.items()
            if one.own is not None and one.own.noticed
        }

    def records(self) -> list[dict[str, object]]:
        """Metrics as plain data for JSON."""
        return [asdict(metric) for metric in self.metrics]

    def statistic_records(self) -> list[dict[str, object]]:
        """Statistics as plain data for JSON, with their 95 % intervals."""
        found = []
        for (estimator, name, estimate), statistic in self.statistics.items():
            low, high = statistic.interval(0.95)
            interval = {"low_95": low, "high_95": high, "p_value": statistic.p_value()}
            whose = {"estimator": estimator, "estimate": estimate}
            found.append({**whose, **asdict(statistic), "name": name, **interval})
        return found

    def worst_segments(self) -> dict[str, dict[str, list[dict[str, object]]]]:
        """Where each estimate of each run errs most, as plain data for JSON."""
        return {
            name: {
                estimate: [asdict(segment) for segment in found.trajectory.worst]
                for estimate, found in one.estimates.items()
                if found.trajectory is not None
            }
            for name, one in self.scores.items()
        }

    def lag_records(self) -> dict[str, dict[str, object]]:
        """Poses of each run as known at each lag, and the mean time of a step, as plain data for JSON."""
        return {
            name: {
                "step_time_mean_ms": mean_step_ms(one.run),
                "lags": [lag.record() for lag in one.lags],
            }
            for name, one in self.scores.items()
            if one.lags
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


def _statistics(name: str, scores: RunScores) -> Iterator[tuple[Entry, Statistic]]:
    for estimate, found in scores.estimates.items():
        yield from (((name, key, estimate), statistic) for key, statistic in found.statistics.items())
    yield from (((name, key, None), statistic) for key, statistic in scores.statistics.items())


def _of_pairs(pairs: Mapping[tuple[str, str], PairScores]) -> Iterator[tuple[Entry, Statistic]]:
    for pair, scores in pairs.items():
        statistic = None if scores.smoothing is None else scores.smoothing.statistic()
        if statistic is not None:
            yield ("|".join(pair), statistic.name, None), statistic


def _plain(row: Bin) -> dict[str, object]:
    """Plain data in which what is no number is null."""
    return {key: value if np.isfinite(value) else None for key, value in asdict(row).items()}


def mean_step_ms(run: Run) -> float | None:
    """Mean time of a step of a run [ms]; None where it is not known."""
    return float(1e3 * run.cost.step_time.mean()) if len(run.cost.step_time) else None


def headline(reference: Reference) -> str:
    """Key of the headline error: the ATE, planar where the reference is [m]."""
    return "ate_planar_rmse" if reference.planar else "ate_rmse"


def inertial_path(record: Record) -> float:
    """Length of the path by the inertial data alone [m]; NaN where the record lacks them."""
    if record.step_twist is None:
        return float("nan")
    return float(np.linalg.norm(record.step_twist[1:, 3:], axis=1) @ np.diff(record.stamp))


def evaluate(
    runs: Mapping[str, Run], record: Record, own: Mapping[str, OwnClock] | None = None
) -> Evaluation:
    """Score runs, in their order.

    Parameters
    ----------
    runs : mapping of name to Run
        Incomplete runs are scored on the frames they finished.
    record : Record
        Of the drive behind them.
    own : mapping of name to OwnClock, optional
        How those from elsewhere are matched with the reference.
    """
    clocks = own or {}
    against = "" if record.reference is None else record.reference.name
    scores = {
        name: score_run(run, record, clocks.get(name))
        for name, run in runs.items()
        if len(run.stamp) >= _FEWEST
    }
    fused = {name: run for name, run in runs.items() if not run.elsewhere}
    equal = {item.pair for item in shared_information(fused, record.common_set) if item.equal}
    pairs = {
        (a, b): score_pair(scores[a], scores[b], record, equal=(a, b) in equal)
        for a, b in combinations(scores, 2)
    }
    travelled = inertial_path(record)
    found = [
        metric for one in scores.values() for metric in metrics.of_run(one, against, travelled=travelled)
    ]
    for (a, b), pair in pairs.items():
        found += metrics.of_pair(scores[a], scores[b], pair)
    return Evaluation(
        metrics=[metric for metric in found if np.isfinite(metric.value)],
        statistics={
            entry: statistic
            for entry, statistic in chain(
                *(_statistics(name, one) for name, one in scores.items()), _of_pairs(pairs)
            )
            if np.isfinite(statistic.value)
        },
        scores=scores,
        pairs=pairs,
    )
