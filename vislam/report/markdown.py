"""The results table of a ``metrics.json`` for a README."""

from typing import Any

_ROWS = (
    ("ate_rmse", "ATE, SE(3) aligned [m]", 2),
    ("ate_planar_rmse", "ATE, planar aligned [m]", 2),
    ("ate_planar_rmse_causal", "the same, as known at each time [m]", 2),
    ("held_out_median", "held-out tracks, median error [px]", 2),
    ("path_length", "path length [m]", 1),
    ("height_end", "height at the end [m]", 1),
    ("kitti_t_rel", "KITTI drift [%]", 2),
    ("nees_pose", "NEES of the pose per degree of freedom", 1),
    ("nees_position_planar", "NEES of the position per degree of freedom", 1),
    ("nis_per_dof", "NIS per degree of freedom", 2),
    ("observations_used", "observations used", 0),
    ("step_time_p50_ms", "step time, median [ms]", 1),
    ("step_time_p95_ms", "step time, 95th percentile [ms]", 1),
    ("total_time_s", "total time [s]", 1),
    ("peak_rss_mb", "peak memory [MB]", 0),
)


def results_table(document: dict[str, Any]) -> str:
    """Markdown table of a ``metrics.json``, with data, reference, machine and date."""
    values = {(metric["estimator"], metric["key"]): metric["value"] for metric in document["metrics"]}
    names = list(document["runs"])
    lines = ["| | " + " | ".join(names) + " |", "|---|" + "---:|" * len(names)]
    for key, title, digits in _ROWS:
        cells = [values.get((name, key)) for name in names]
        if any(cell is not None for cell in cells):
            drawn = ("-" if cell is None else f"{cell:.{digits}f}" for cell in cells)
            lines.append(f"| {title} | " + " | ".join(drawn) + " |")
    dataset, made = document["dataset"], document["provenance"]
    simulated = " (SIMULATED)" if dataset["stand_in"] else ""
    against = f"{dataset['reference']} ({dataset['reference_limits']})"
    machine = f"{made['cpu']}, gtsam {made['gtsam']}, {made['date']}"
    lines += ["", f"{dataset['name']}{simulated} against {against}; {machine}."]
    return "\n".join(lines)
