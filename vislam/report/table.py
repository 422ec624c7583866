"""The tables of a comparison, one for each estimate: rows of metrics, a column for each estimator."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from vislam.core.run import ESTIMATES, Estimate, Run
from vislam.evaluation import Evaluation
from vislam.evaluation.metric import METRICS

_LEFT_OUT = ("height_end",)
"""Metrics that have a name and no row."""
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


def comparison_tables(
    runs: Mapping[str, Run], evaluation: Evaluation, *, keys: Sequence[str] | None = None
) -> dict[Estimate, Table]:
    """The table of each estimate that some run has, in it the runs that have it and no other."""
    found = {}
    for estimate in ESTIMATES:
        own = {name: run for name, run in runs.items() if estimate in run.estimates}
        if own:
            found[estimate] = _table(own, evaluation, estimate, keys)
    return found


def _table(
    runs: Mapping[str, Run], evaluation: Evaluation, estimate: Estimate, keys: Sequence[str] | None
) -> Table:
    """Rows that at least one run has, a column each; ``keys`` selects rows."""
    rows = []
    for key, spec in METRICS.items():
        if key in _LEFT_OUT or (keys is not None and key not in keys):
            continue
        values = [evaluation.value(name, key, estimate) for name in runs]
        if any(value is not None for value in values):
            rows.append([spec.label, *("-" if v is None else f"{v:.{spec.digits}f}" for v in values)])
    states = [
        _state(run, degenerate=bool(evaluation.degenerate(name, estimate))) for name, run in runs.items()
    ]
    if any(state != _SOUND for state in states):
        rows.insert(0, ["status", *states])
    return Table(["", *runs], rows)


def _state(run: Run, *, degenerate: bool) -> str:
    if not run.complete:
        return f"INCOMPLETE ({len(run.stamp)} of {run.frames_expected})"
    return "DEGENERATE" if degenerate else _SOUND
