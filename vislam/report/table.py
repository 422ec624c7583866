"""The table of a comparison: rows of metrics, a column for each estimator."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from vislam.core.run import Run
from vislam.evaluation import Evaluation

_ROWS = (
    ("ate_rmse", "ATE, SE(3) aligned", "m", 2),
    ("ate_planar_rmse", "ATE, planar aligned", "m", 2),
    ("ate_rotation_rmse", "attitude error, aligned", "deg", 2),
    ("held_out_median", "held-out tracks, median error", "px", 2),
    ("path_length", "path length", "m", 1),
    ("kitti_t_rel", "KITTI drift", "%", 2),
    ("kitti_r_rel", "KITTI turn drift", "deg/100m", 3),
    ("map_error_median", "landmark error, median", "m", 2),
    ("drift_end", "drift at the end", "%", 2),
    ("nees_pose", "NEES of the pose per degree of freedom", "", 2),
    ("nees_position_planar", "NEES of the position per degree of freedom", "", 2),
    ("nis_per_dof", "NIS per degree of freedom", "", 2),
    ("fit_per_dof", "fit per degree of freedom", "", 2),
    ("yaw_information_gained", "yaw information gained", "1/rad²", 1),
    ("landmarks", "landmarks", "", 0),
    ("observations_used", "observations used", "", 0),
    ("observations_gated", "observations gated", "", 0),
    ("step_time_p50_ms", "step time, median", "ms", 1),
    ("step_time_p95_ms", "step time, 95th percentile", "ms", 1),
    ("total_time_s", "total time", "s", 1),
    ("peak_rss_mb", "peak memory", "MB", 0),
)
SHORT = (
    "ate_rmse",
    "ate_planar_rmse",
    "held_out_median",
    "path_length",
    "kitti_t_rel",
    "nis_per_dof",
    "step_time_p50_ms",
    "total_time_s",
    "peak_rss_mb",
)
"""Rows that the terminal shows: ten at most, with the status."""

_SOUND = "complete"


@dataclass(frozen=True)
class Table:
    """A table ready to be drawn."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]


def comparison_table(
    runs: Mapping[str, Run], evaluation: Evaluation, *, keys: Sequence[str] | None = None
) -> Table:
    """Rows that at least one estimator has, a column each; ``keys`` selects rows."""
    rows = []
    for key, title, unit, digits in _ROWS:
        if keys is not None and key not in keys:
            continue
        values = [evaluation.value(name, key) for name in runs]
        if any(value is not None for value in values):
            label = f"{title} [{unit}]" if unit else title
            rows.append([label, *("-" if v is None else f"{v:.{digits}f}" for v in values)])
    states = [_state(run, degenerate=bool(evaluation.degenerate(name))) for name, run in runs.items()]
    if any(state != _SOUND for state in states):
        rows.insert(0, ["status", *states])
    return Table(["", *runs], rows)


def _state(run: Run, *, degenerate: bool) -> str:
    if not run.complete:
        return f"INCOMPLETE ({len(run.stamp)} of {run.frames_expected})"
    return "DEGENERATE" if degenerate else _SOUND
