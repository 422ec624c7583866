"""The checks of a config on all drives of a study together: what one drive cannot tell, several can."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from vislam.checks.judge import Checklist, Verdict
from vislam.comparison.config import Config
from vislam.core.run import Log, Run
from vislam.evaluation import Evaluation
from vislam.evaluation.lookup import Entry
from vislam.evaluation.metric import METRICS
from vislam.evaluation.metrics import Metric
from vislam.evaluation.statistics import Statistic


def judge_pooled(config: Config, results: Iterable[Mapping[str, Any]]) -> list[Verdict]:
    """Judge the checks of a config on the finished trials of a point.

    A bound is on the mean of a metric over the drives, a test is of the statistic of all drives together. A
    run that did not finish on one of them is incomplete, and nothing of it holds.

    Parameters
    ----------
    config : Config
    results : iterable of mapping
        Of the trials.
    """
    found = list(results)
    runs = {name: _run(name, found) for name in config.estimators}
    evaluation = Evaluation(_mean_metrics(found), _pooled_statistics(found))
    return Checklist.of(config, saved=None, tolerance=0.0).judge(runs, evaluation)


def pool(statistics: Iterable[Statistic]) -> Statistic:
    """Average of the same statistic of independent drives, each counted alike.

    Its variance is that of the mean of theirs: ``n`` drives of ``e_i`` effective samples and ``f_i`` degrees
    of freedom have ``n^2 / sum(1 / (f_i e_i))`` degrees of freedom together.
    """
    found = list(statistics)
    freedom = float(np.mean([one.freedom for one in found]))
    together = len(found) ** 2 / sum(1.0 / (one.freedom * one.effective) for one in found)
    return Statistic(
        name=found[0].name,
        value=float(np.mean([one.value for one in found])),
        freedom=freedom,
        samples=sum(one.samples for one in found),
        effective=max(1.0, together / freedom),
        convention=f"{found[0].convention}; mean over {len(found)} drives",
        fitted=found[0].fitted,
    )


def _pooled_statistics(results: list[Mapping[str, Any]]) -> dict[Entry, Statistic]:
    grouped: dict[Entry, list[Statistic]] = defaultdict(list)
    for result in results:
        for record in result["statistics"]:
            plain = {key: record[key] for key in Statistic.__dataclass_fields__}
            if plain["value"] is not None:
                grouped[record["estimator"], record["name"], record["estimate"]].append(Statistic(**plain))
    return {entry: pool(found) for entry, found in grouped.items()}


def _mean_metrics(results: list[Mapping[str, Any]]) -> list[Metric]:
    grouped: dict[Entry, list[float]] = defaultdict(list)
    for result in results:
        for record in result["metrics"]:
            if record["value"] is not None:
                grouped[record["estimator"], record["key"], record["estimate"]].append(record["value"])
    return [
        Metric(name, key, float(np.mean(values)), _unit(key), estimate=estimate)
        for (name, key, estimate), values in grouped.items()
        if len(values) == len(results)
    ]


def _unit(key: str) -> str:
    """Unit of a metric; 1 for one without, or that is not in the registry."""
    return (METRICS[key].unit if key in METRICS else "") or "1"


def _run(name: str, results: list[Mapping[str, Any]]) -> Run:
    """A run that is complete if it is so on all drives."""
    broken = [one for one in results if not one["runs"].get(name, {}).get("complete", False)]
    error = "" if results else "no drive has finished"
    if broken:
        error = f"{len(broken)} of {len(results)} drives, the first: {broken[0]['reason']}"
    return Run.without_frames(name, Log(error=error), frames_expected=0, observations=0)
