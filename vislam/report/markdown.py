"""The results tables of a ``metrics.json`` for a README, one for each estimate."""

from typing import Any

from vislam.core.run import ESTIMATES, Estimate
from vislam.evaluation.lookup import Lookup
from vislam.evaluation.metric import ESTIMATE_TITLES, METRICS

_KEYS = (
    "ate_rmse",
    "ate_planar_rmse",
    "held_out_median",
    "path_length",
    "height_end",
    "kitti_t_rel",
    "nees_pose",
    "nees_position_planar",
    "nees_pose_considered",
    "nees_position_planar_considered",
    "nis_per_dof",
    "observations_used",
    "step_time_p50_ms",
    "step_time_p95_ms",
    "total_time_s",
    "peak_rss_mb",
)


def results_table(document: dict[str, Any]) -> str:
    """Markdown tables of a ``metrics.json``, with data, reference, machine and date."""
    values = Lookup(
        {(m["estimator"], m["key"], m["estimate"]): float(m["value"]) for m in document["metrics"]}
    )
    lines = []
    for estimate in ESTIMATES:
        names = [name for name, run in document["runs"].items() if estimate in run["estimates"]]
        if names:
            lines += [f"**{ESTIMATE_TITLES[estimate]}**", "", *_block(values, names, estimate), ""]
    dataset, made = document["dataset"], document["provenance"]
    simulated = " (SIMULATED)" if dataset["synthetic"] else ""
    against = f"{dataset['reference']} ({dataset['reference_limits']})"
    machine = f"{made['cpu']}, gtsam {made['gtsam']}, {made['date']}"
    lines.append(f"{dataset['name']}{simulated} against {against}; {machine}.")
    return "\n".join(lines)


def _block(values: Lookup[float], names: list[str], estimate: Estimate) -> list[str]:
    """Lines of the table of an estimate."""
    lines = ["| | " + " | ".join(names) + " |", "|---|" + "---:|" * len(names)]
    for spec in map(METRICS.__getitem__, _KEYS):
        cells = [values.find(name, spec.key, estimate) for name in names]
        if any(cell is not None for cell in cells):
            places = spec.places(cells)
            drawn = ("-" if cell is None else f"{cell:.{places}f}" for cell in cells)
            lines.append(f"| {spec.label} | " + " | ".join(drawn) + " |")
    return lines
