"""The registry of metrics: title, unit, digits and direction of each.

Whoever shows or judges metrics takes them from here; :mod:`vislam.evaluation.metrics` computes them.
"""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

from vislam.core.run import BESIDE, Beside, Estimate

Better = Literal["less", "one", ""]
"""Which value is better: less; near 1, as of a consistent estimator; or it is no matter of better."""

_LEAST_M = 1e-5
"""Shorter lengths are those of rounding, and shown as 0 [m]."""


@dataclass(frozen=True)
class MetricSpec:
    """Description of a metric.

    Attributes
    ----------
    key : str
        As in ``metrics.json``.
    title : str
    unit : str
        Empty for a plain number.
    digits : int
        Behind the point, in a table.
    better : str
    short : str
        Title where there is little room; that of the table if it is empty.
    """

    key: str
    title: str
    unit: str = ""
    digits: int = 2
    better: Better = ""
    short: str = ""

    def places(self, values: Iterable[float | None]) -> int:
        """Digits behind the point for values that stand together: of lengths, two that count of the largest.

        A hand-held rig that stays within a room is millimetres off, a car metres.
        """
        finite = [abs(value) for value in values if value is not None and math.isfinite(value)]
        largest = max(finite, default=0.0)
        if self.unit != "m" or largest < _LEAST_M:
            return self.digits
        return max(self.digits, 1 - math.floor(math.log10(largest)))

    @property
    def label(self) -> str:
        """Title with the unit."""
        return with_unit(self.title, self.unit)

    @property
    def short_label(self) -> str:
        """Short title with the unit."""
        return with_unit(self.short_title, self.unit)

    @property
    def short_title(self) -> str:
        """Short title, that of the table if there is none."""
        return self.short or self.title


def of_statistic(name: str) -> MetricSpec:
    """What is known of a statistic, whose value is a metric of its name or of that per degree of freedom."""
    return METRICS[name] if name in METRICS else METRICS[f"{name}_per_dof"]


def at_lag(key: str, lag: str) -> str:
    """Key of a metric of the poses as known at a lag, a number of frames or ``all``."""
    return f"{key}_lag_{lag}"


def with_unit(title: str, unit: str) -> str:
    """A title with its unit, if it has one."""
    return f"{title} [{unit}]" if unit else title


_ALL = (
    MetricSpec("ate_rmse", "ATE, SE(3) aligned", "m", 2, "less", "ATE"),
    MetricSpec("ate_planar_rmse", "ATE, planar aligned", "m", 2, "less", "planar ATE"),
    MetricSpec("ate_rotation_rmse", "attitude error, aligned", "deg", 2, "less", "attitude error"),
    MetricSpec("ate_sim3_rmse", "ATE, Sim(3) aligned", "m", 2, "less", "ATE with free scale"),
    MetricSpec("rows_matched", "rows matched with the reference", "", 0),
    MetricSpec("share_matched", "share matched", "%", 1),
    MetricSpec("completion", "completion", "%", 1),
    MetricSpec("scale", "scale fitted", "", 4),
    MetricSpec("clock_offset", "clock offset estimated", "s", 4),
    MetricSpec(
        "held_out_median", "held-out tracks, median error", "px", 2, "less", "error of held-out tracks"
    ),
    MetricSpec("path_length", "path length", "m", 1),
    MetricSpec("path_length_inertial", "path length by the inertial data alone", "m", 1),
    MetricSpec("height_end", "height at the end", "m", 1),
    MetricSpec("kitti_t_rel", "KITTI drift", "%", 2, "less"),
    MetricSpec("kitti_r_rel", "KITTI turn drift", "deg/100m", 3, "less"),
    MetricSpec("map_error_median", "landmark error, median", "m", 2, "less", "landmark error"),
    MetricSpec("drift_end", "drift at the end", "%", 2, "less"),
    MetricSpec("nees_pose", "NEES of the pose per degree of freedom", "", 2, "one"),
    MetricSpec("nees_position_planar", "NEES of the position per degree of freedom", "", 2, "one"),
    MetricSpec("nees_position_aligned", "NEES of the position in space per degree of freedom", "", 2, "one"),
    MetricSpec("bound_ratio_rotation", "squared error of rotations over the bound", "", 2, "one"),
    MetricSpec("bound_ratio_position", "squared error of positions over the bound", "", 2, "one"),
    MetricSpec("bound_excess_rotation", "rotations, excess over the bound", "%"),
    MetricSpec("bound_excess_position", "positions, excess over the bound", "%"),
    MetricSpec("scale_gap_pose", "pose errors over estimated sigmas", "", 2, "one"),
    MetricSpec("scale_gap_position", "position errors over estimated sigmas", "", 2, "one"),
    MetricSpec("scale_gap_position_planar", "planar position errors over estimated sigmas", "", 2, "one"),
    MetricSpec("scale_gap_position_aligned", "aligned position errors over estimated sigmas", "", 2, "one"),
    MetricSpec("coverage_90_pose", "poses within the 90 % region", "", 2),
    MetricSpec("coverage_90_position", "positions within the 90 % region", "", 2),
    MetricSpec("coverage_90_position_planar", "planar positions within the 90 % region", "", 2),
    MetricSpec("coverage_90_position_aligned", "aligned positions within the 90 % region", "", 2),
    MetricSpec("log_score_pose", "log score of the pose", "nats", 2),
    MetricSpec("energy_score_position", "energy score of the position", "m", 3, "less"),
    MetricSpec("map_points_complete", "map points found", "%", 1),
    MetricSpec("nis_per_dof", "NIS per degree of freedom", "", 2, "one"),
    MetricSpec("nis_autocorrelation", "innovations, lag-1 autocorrelation", "", 2),
    MetricSpec("smoothing_per_dof", "filtered less smoothed per degree of freedom", "", 2, "one"),
    MetricSpec("smoothing_indefinite", "frames more certain filtered than smoothed", "", 3),
    MetricSpec("fit_per_dof", "fit per degree of freedom", "", 2, "one"),
    MetricSpec("spurious_yaw_information", "spurious yaw information", "1/rad²", 1),
    MetricSpec("landmarks", "landmarks", "", 0),
    MetricSpec("observations_used", "observations used", "", 0),
    MetricSpec("observations_gated", "observations gated", "", 0),
    MetricSpec("step_time_p50_ms", "step time, median", "ms", 1, "less"),
    MetricSpec("step_time_p95_ms", "step time, 95th percentile", "ms", 1, "less"),
    MetricSpec("total_time_s", "total time", "s", 1, "less"),
    MetricSpec("peak_rss_mb", "peak memory", "MB", 0, "less"),
)
_OF_COVARIANCES = ("nees_", "scale_gap_", "coverage_90_", "log_score_", "energy_score_")
"""How the keys start of what errors are by their covariances."""
BESIDE_TITLES: dict[Beside, str] = {"considered": "shared errors considered", "sandwich": "sandwich"}
"""Titles of the covariances that a run may have beside its own."""


def of_beside(key: str, kind: Beside) -> str:
    """Key of a metric that is by other covariances than the estimator's own."""
    return f"{key}_{kind}"


def _with_beside(specs: Iterable[MetricSpec]) -> Iterator[MetricSpec]:
    """Metrics, and behind those of the estimator's own covariances the same by the others."""
    for spec in specs:
        yield spec
        if spec.key.startswith(_OF_COVARIANCES):
            for kind in BESIDE:
                short = f"{spec.short}, {BESIDE_TITLES[kind]}" if spec.short else ""
                title = f"{spec.title}, {BESIDE_TITLES[kind]}"
                yield replace(spec, key=of_beside(spec.key, kind), title=title, short=short)


METRICS = {spec.key: spec for spec in _with_beside(_ALL)}
"""Metrics that are shown by a name of their own, in the order of the tables."""
_RELATIVE = (
    MetricSpec("rpe_1s_rmse", "RPE over 1 s", "m", 3, "less"),
    MetricSpec("displacement_1s_rmse", "error of displacements over 1 s", "m", 3, "less"),
)
LAG_METRICS = {
    spec.key: spec
    for spec in (
        *(METRICS[key] for key in ("ate_rmse", "ate_planar_rmse")),
        *_RELATIVE,
        *(METRICS[key] for key in ("held_out_median", "nees_pose")),
        *(METRICS[key] for key in ("nees_position_planar", "nees_position_aligned")),
    )
}
"""Metrics of the poses as known at a lag, in the order of the tables."""
ESTIMATE_TITLES: dict[Estimate, str] = {
    "filtered": "filtered (causal)",
    "smoothed": "smoothed (from all data)",
}
"""Titles of the blocks that metrics are shown in."""
_FAMILIES_OF_ERRORS = (
    "ate_",
    "rpe_",
    "displacement_",
    "kitti_",
    "drift_",
    "map_error_",
    "held_out_",
    "energy_score_",
)
"""How the keys of all errors start, those of a length or a share of them included."""


def is_error(key: str) -> bool:
    """Whether a metric is an error, of whatever alignment, length or percentile."""
    return key.startswith(_FAMILIES_OF_ERRORS)
