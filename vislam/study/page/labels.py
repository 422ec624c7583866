"""How metrics and swept parameters of a study are called."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from vislam.evaluation.metric import METRICS, MetricSpec
from vislam.study.intervals import Estimate
from vislam.study.trials import Trials

_UPRIGHT = MetricSpec(
    "ate_yaw_position_rmse",
    "ATE, heading and position aligned",
    "m",
    2,
    "less",
    "ATE by heading and position",
)
"""Error of runs whose roll and pitch are observable."""
ERRORS = {_UPRIGHT.key: _UPRIGHT} | {
    key: METRICS[key]
    for key in (
        "ate_rmse",
        "ate_planar_rmse",
        "ate_rotation_rmse",
        "kitti_t_rel",
        "map_error_median",
        "held_out_median",
    )
}
"""Errors that a study shows; the first that it has is its headline, that of upright runs in theirs alone."""
TIME = "step_time_p50_ms"
_UNITS = ("px", "m", "s", "ms", "deg", "hz")


def errors(trials: Trials) -> list[str]:
    """Metrics of ``ERRORS`` that some estimator has in some trial, that of upright runs only if they are."""
    keys = [key for key in ERRORS if trials.upright or key != _UPRIGHT.key]
    return [key for key in keys if trials.has(key)]


def position_error(trials: Trials) -> MetricSpec:
    """Absolute trajectory error by the alignment that leaves what the trials observe."""
    return _UPRIGHT if trials.upright else ERRORS["ate_rmse"]


def metric_label(key: str) -> str:
    """Name of a metric with its unit; its key, if it has no name of its own."""
    spec = ERRORS.get(key) or METRICS.get(key)
    return key if spec is None else spec.short_label


def parameter_label(path: str) -> str:
    """Name of a swept parameter with its unit, from its dotted path."""
    name, unit = _parts(path)
    return f"{name} [{unit}]" if unit else name


def setting(path: str, value: Any) -> str:
    """A swept parameter at a value, in words."""
    name, unit = _parts(path)
    return f"{name} {plain(value)} {unit}".rstrip()


def point_label(point: Mapping[str, Any]) -> str:
    """A point of a study in words."""
    return ", ".join(setting(path, value) for path, value in point.items()) or "all"


def plain(value: Any) -> str:
    """Value of a parameter as text."""
    if isinstance(value, tuple):
        return " ".join(plain(item) for item in value)
    return f"{value:g}" if isinstance(value, float) else str(value)


def with_interval(found: Estimate | None, unit: str = "") -> str:
    """A number with its interval, in three digits."""
    if found is None:
        return "-"
    told = f"{found.value:.3g} {unit}".rstrip()
    return f"{told} ({found.low:.3g} to {found.high:.3g})" if np.isfinite(found.low) else told


def percent(found: Estimate | None) -> str:
    """A share with its interval, in percent."""
    if found is None:
        return "-"
    return f"{100 * found.value:.3g} % ({100 * found.low:.3g} to {100 * found.high:.3g})"


def _parts(path: str) -> tuple[str, str]:
    """Name of a parameter in words, and its unit, empty if its name has none."""
    *words, last = path.rsplit(".", 1)[-1].split("_")
    return (" ".join(words), last) if words and last in _UNITS else (" ".join([*words, last]), "")
