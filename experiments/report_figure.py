"""The report's figures beside ours, drawn from saved results of ``report_ds3`` and of ``ds3``.

``python -m experiments.report_figure results/report_ds3-<id> results/ds3-<id> FIGURE``; that of the case
study is ``docs/case_study/report_pipeline.png``.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vislam.base.errors import DataError
from vislam.base.files import replace_whole
from vislam.base.types import Array
from vislam.cli.command import answer
from vislam.comparison.results import Results
from vislam.core.run import Run
from vislam.evaluation import evaluate
from vislam.geometry import se3
from vislam.report.placement import reference_T_world

FIGURES = (
    ("Fig. 2\ndead reckoning", "dead_reckoning", "dead_reckoning"),
    ("Fig. 4\nmap, poses of dead reckoning", "mapping_only", "isam2"),
    ("Fig. 5\nSLAM, pose gain 0.01", "report_ekf_slowed", "isam2"),
    ("section III-D\nSLAM as printed", "report_ekf", "ekf"),
)
"""What each column shows: the report's run above, and the run of ours below it."""
_MARGIN = 0.2
"""Room around the reference, as a share of its length."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the figure, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m experiments.report_figure", description=__doc__)
    parser.add_argument("report", type=Path, help="results folder of the report's runs")
    parser.add_argument("ours", type=Path, help="results folder of ours, on the same drive")
    parser.add_argument("figure", type=Path, help="file to draw to (.png)")
    options = parser.parse_args(arguments)
    return answer(lambda: _draw(options), verbose=False)


def _draw(options: argparse.Namespace) -> int:
    sides = [Results.load(folder) for folder in (options.report, options.ours)]
    # Dead reckoning lies under the others.
    needed = {one for _, one, _ in FIGURES}, {"dead_reckoning", *(other for _, _, other in FIGURES)}
    for folder, side, wanted in zip((options.report, options.ours), sides, needed, strict=True):
        if missing := wanted - side.runs.keys():
            raise DataError(f"{folder}: expected the runs {sorted(wanted)}, got none of {sorted(missing)}")
    with replace_whole(options.figure) as temporary:
        beside(*sides).savefig(temporary, format="png", dpi=110)
    return 0


def beside(report: Results, ours: Results) -> Figure:
    """Draw a column for each pair of runs."""
    figure = Figure(figsize=(2.7 * len(FIGURES), 7.0), layout="constrained")
    rows = figure.subplots(2, len(FIGURES), squeeze=False)
    for results, row, column in ((report, rows[0], 1), (ours, rows[1], 2)):
        scores = evaluate(results.runs, results.record)
        for axes, told in zip(row, FIGURES, strict=True):
            name = told[column]
            title, error = told[0] if column == 1 else f"ours\n{name}", scores.value(name, "ate_planar_rmse")
            _panel(axes, results, name, title=title + ("" if error is None else f", ATE {error:.3g} m"))
    # In one panel or another everything is drawn; the legend has it once.
    found = {key: item for axes in rows.flat for item, key in zip(*axes.get_legend_handles_labels())}  # noqa: B905
    figure.legend(found.values(), found.keys(), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def _panel(axes: Axes, results: Results, name: str, *, title: str) -> None:
    """Draw a levelled run from above, laid on the reference, turned and moved in the plane only."""
    path, points = _laid(results, results.runs[name])
    axes.plot(*points.T, ".", ms=1.0, color="0.6", label="landmarks", rasterized=True)
    # The report's colours: green for dead reckoning, red for SLAM.
    beneath = _laid(results, results.runs["dead_reckoning"])[0]
    axes.plot(*beneath.T, color="#009E73", lw=1.0, label="dead reckoning")
    if name != "dead_reckoning":
        axes.plot(*path.T, color="#D55E00", lw=1.2, label="estimate")
    shown, reference = path, results.record.reference
    if reference is not None:
        shown = reference.position[:, :2]
        axes.plot(*shown.T, "k.", ms=2.0, label="reference")
    low, high = shown.min(axis=0), shown.max(axis=0)
    margin = _MARGIN * float((high - low).max())
    axes.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))
    axes.set_aspect("equal")
    axes.set_title(title, fontsize=8)
    axes.tick_params(labelsize=6)


def _laid(results: Results, run: Run) -> tuple[Array, Array]:
    """Path and landmarks from above ``(T, 2)``, ``(m, 2)`` [m]."""
    run, reference = run.levelled(), results.record.reference
    moved, point = np.eye(4), np.eye(4)
    if reference is not None:
        laid = reference_T_world(run, reference, planar=True)
        moved, point = np.eye(4) if laid is None else laid, reference.imu_T_point
    path = (moved @ run.final.world_T_imu @ point)[:, :2, 3]
    return path, se3.transform(moved, run.landmarks.points_world)[:, :2]


if __name__ == "__main__":
    sys.exit(main())
