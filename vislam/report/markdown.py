"""The results table of a ``metrics.json`` for a README."""

from typing import Any

from vislam.evaluation.metric import METRICS

_KEYS = (
    "ate_rmse",
    "ate_planar_rmse",
    "ate_planar_rmse_causal",
    "held_out_median",
    "path_length",
    "height_end",
    "kitti_t_rel",
    "nees_pose",
    "nees_position_planar",
    "nis_per_dof",
    "observations_used",
    "step_time_p50_ms",
    "step_time_p95_ms",
    "total_time_s",
    "peak_rss_mb",
)


def results_table(document: dict[str, Any]) -> str:
    """Markdown table of a ``metrics.json``, with data, reference, machine and date."""
    values = {(metric["estimator"], metric["key"]): metric["value"] for metric in document["metrics"]}
    names = list(document["runs"])
    lines = ["| | " + " | ".join(names) + " |", "|---|" + "---:|" * len(names)]
    for spec in map(METRICS.__getitem__, _KEYS):
        cells = [values.get((name, spec.key)) for name in names]
        if any(cell is not None for cell in cells):
            drawn = ("-" if cell is None else f"{cell:.{spec.digits}f}" for cell in cells)
            lines.append(f"| {spec.label} | " + " | ".join(drawn) + " |")
    dataset, made = document["dataset"], document["provenance"]
    simulated = " (SIMULATED)" if dataset["stand_in"] else ""
    against = f"{dataset['reference']} ({dataset['reference_limits']})"
    machine = f"{made['cpu']}, gtsam {made['gtsam']}, {made['date']}"
    lines += ["", f"{dataset['name']}{simulated} against {against}; {machine}."]
    return "\n".join(lines)
