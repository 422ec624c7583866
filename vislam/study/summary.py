"""What the terminal shows of a study: a row for each point and estimator."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import t

from vislam import config as configuration
from vislam.study.points import Point

HEADER = ("point", "estimator", "trials", "failed", "ATE [m]", "NEES pose", "95 % interval")
_ERROR = "ate_rmse"
_NEES = "nees_pose"


def rows_of(point: Point, results: Iterable[Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Rows of a point: how many trials, how many without the estimator's answer, its mean error and NEES.

    The NEES per degree of freedom, 1 if the estimator is consistent, is averaged over the trials; its
    interval is Student's, of the trials' own means: trials are independent, the times of one are not.
    """
    trials = 0
    errors: dict[str, list[float]] = {name: [] for name in point.tree["estimators"]}
    claims: dict[str, list[float]] = {name: [] for name in errors}
    answered = dict.fromkeys(errors, 0)
    for result in results:
        trials += 1
        for name in {metric["estimator"] for metric in result["metrics"]} & errors.keys():
            answered[name] += 1
        for metric in result["metrics"]:
            if metric["estimator"] in errors and metric["key"] == _ERROR:
                errors[metric["estimator"]].append(metric["value"])
        for statistic in result["statistics"]:
            if statistic["name"] == _NEES:
                claims[statistic["estimator"]].append(statistic["value"])
    told = ", ".join(f"{path} {configuration.inline(value)}" for path, value in point.values.items()) or "-"
    return [
        (
            told,
            name,
            str(trials),
            str(trials - answered[name]),
            f"{np.mean(errors[name]):.3f}" if errors[name] else "-",
            f"{np.mean(claims[name]):.3f}" if claims[name] else "-",
            _interval(claims[name]),
        )
        for name in errors
    ]


def _interval(values: Sequence[float]) -> str:
    """95 % confidence interval of a mean of independent values."""
    if len(values) < 2:
        return "-"
    half = t.ppf(0.975, len(values) - 1) * np.std(values, ddof=1) / np.sqrt(len(values))
    return f"{np.mean(values) - half:.3f} to {np.mean(values) + half:.3f}"
