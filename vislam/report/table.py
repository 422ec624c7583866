"""The tables of a comparison, one for each estimate: rows of metrics, a column for each estimator."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from vislam.core.run import ESTIMATES, Estimate, Run
from vislam.evaluation import Evaluation
from vislam.evaluation.metric import METRICS

_LEFT_OUT = ("height_end", "path_length_inertial")
"""Metrics that have a name and no row."""
SHORT = (
    "ate_rmse",
    "ate_planar_rmse",
    "share_matched",
    "held_out_median",
    "path_length",
    "kitti_t_rel",
    "nees_pose",
    "nees_position_planar",
    "nees_position_aligned",
    "nees_pose_considered",
    "nees_position_planar_considered",
    "nees_position_aligned_considered",
    "nis_per_dof",
    "step_time_p50_ms",
    "total_time_s",
    "peak_rss_mb",
)
"""Rows that the terminal shows: ten at most with the status, eleven where shared errors are considered."""
MARKS = "*: best, or not told apart from it; !: outside the interval of a consistent estimator"
"""What the marks of the terminal's tables mean."""

_SOUND = "complete"
_SURE = 0.05
"""p-value under which a difference is more than luck."""


@dataclass(frozen=True)
class Table:
    """A table ready to be drawn.

    Attributes
    ----------
    header : sequence of str
    rows : sequence of sequences of str
    keys : sequence of str
        Key of the metric in each row, empty for any other; none where rows are no metrics.
    """

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    keys: Sequence[str] = ()


def comparison_tables(
    runs: Mapping[str, Run],
    evaluation: Evaluation,
    *,
    keys: Sequence[str] | None = None,
    marks: bool = False,
) -> dict[Estimate, Table]:
    """The table of each estimate that some run has, in it the runs that have it and no other.

    ``marks`` says whether to mark the best and the inconsistent.
    """
    found = {}
    for estimate in ESTIMATES:
        own = {name: run for name, run in runs.items() if estimate in run.estimates}
        if own:
            found[estimate] = _table(own, evaluation, estimate, keys, marks=marks)
    return found


def _table(
    runs: Mapping[str, Run],
    evaluation: Evaluation,
    estimate: Estimate,
    keys: Sequence[str] | None,
    *,
    marks: bool,
) -> Table:
    """Rows that at least one run has, a column each; ``keys`` selects rows."""
    rows, shown = [], []
    for key, spec in METRICS.items():
        if key in _LEFT_OUT or (keys is not None and key not in keys):
            continue
        values = [evaluation.value(name, key, estimate) for name in runs]
        if any(value is not None for value in values):
            places = spec.places(values)
            told = ["-" if value is None else f"{value:.{places}f}" for value in values]
            if marks:
                told = [
                    f"{text}{mark}"
                    for text, mark in zip(told, _marks(runs, evaluation, estimate, key), strict=True)
                ]
            rows.append([spec.label, *told])
            shown.append(key)
    states = [
        _state(run, degenerate=bool(evaluation.degenerate(name, estimate))) for name, run in runs.items()
    ]
    if any(state != _SOUND for state in states):
        rows.insert(0, ["status", *states])
        shown.insert(0, "")
    return Table(["", *runs], rows, shown)


def _marks(runs: Mapping[str, Run], evaluation: Evaluation, estimate: Estimate, key: str) -> list[str]:
    """Mark of each run in a row; of errors for runs that use the camera and have a sound estimate alone."""
    if METRICS[key].better == "one":
        return [" !" if _inconsistent(evaluation, name, key, estimate) else "" for name in runs]
    if not key.startswith(("ate_", "held_out_")):
        return [""] * len(runs)
    ranked = {
        name: value
        for name, run in runs.items()
        if (value := evaluation.value(name, key, estimate)) is not None
        and run.complete
        and not run.blind
        and not evaluation.degenerate(name, estimate)
    }
    if len(ranked) < 2:
        return [""] * len(runs)
    best = min(ranked, key=ranked.__getitem__)
    alike = {name for name in ranked if name == best or not _differ(evaluation, best, name, key, estimate)}
    return [" *" if name in alike else "" for name in runs]


def _inconsistent(evaluation: Evaluation, name: str, key: str, estimate: Estimate) -> bool:
    found = evaluation.statistic(name, key.removesuffix("_per_dof"), estimate)
    if found is None:
        return False
    low, high = found.interval(0.95)
    return not low <= found.value <= high


def _differ(evaluation: Evaluation, one: str, other: str, key: str, estimate: Estimate) -> bool:
    """Whether two runs differ by more than luck in their ATE, or on the held-out tracks."""
    found = evaluation.pairs.get((one, other)) or evaluation.pairs.get((other, one))
    pair = None if found is None else found.estimates.get(estimate)
    if pair is None:
        return False
    if key.startswith("ate_"):
        return pair.error is not None and pair.error.real
    return pair.held_out is not None and pair.held_out.p_value <= _SURE


def _state(run: Run, *, degenerate: bool) -> str:
    if not run.complete:
        return f"INCOMPLETE ({len(run.stamp)} of {run.frames_expected})"
    return "DEGENERATE" if degenerate else _SOUND
