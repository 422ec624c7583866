"""Figures of errors against a reference: segments by length, rungs of a ladder, accuracy against time."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from vislam.evaluation import Evaluation
from vislam.evaluation.attribution import Rung
from vislam.evaluation.trajectory_scores import TrajectoryScores
from vislam.report.figures import colours
from vislam.run import Run

_WIDTH = 0.8
"""Share of the room between two lengths that their boxes take."""


def segment_errors(scores: Mapping[str, TrajectoryScores]) -> Figure:
    """Relative errors by the length of the segments, a box an estimator: quartiles, and 5 to 95 %."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    lengths = sorted({length for one in scores.values() for length in one.by_distance})
    width = _WIDTH / max(len(scores), 1)
    for index, (name, one) in enumerate(scores.items()):
        shown = [place for place, length in enumerate(lengths) if length in one.by_distance]
        colour = colours(scores)[name]
        drawn = axes.boxplot(
            [one.by_distance[lengths[place]].translation_error for place in shown],
            positions=[place - 0.5 * _WIDTH + (index + 0.5) * width for place in shown],
            widths=0.85 * width,
            whis=(5, 95),
            showfliers=False,
            patch_artist=True,
            manage_ticks=False,
            boxprops={"facecolor": colour, "edgecolor": colour, "alpha": 0.55},
            whiskerprops={"color": colour},
            capprops={"color": colour},
            medianprops={"color": "black"},
        )
        drawn["boxes"][0].set_label(name)
    axes.set_xticks(range(len(lengths)), [f"{length:g} m" for length in lengths])
    axes.set(xlabel="length of the segment", ylabel="translation error [m]", yscale="log")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    return figure


def ladder(rungs: Sequence[Rung]) -> Figure:
    """Error of each rung, as known in the end and at its own time."""
    figure = Figure(figsize=(9, 0.6 + 0.45 * len(rungs)), layout="constrained")
    axes = figure.subplots()
    place = np.arange(len(rungs))
    for offset, key, colour, label in (
        (-0.2, "error", "#0072B2", "as known in the end"),
        (0.2, "causal", "#E69F00", "as known at each time"),
    ):
        values = [np.nan if (value := getattr(rung, key)) is None else value for rung in rungs]
        bars = axes.barh(place + offset, values, height=0.38, color=colour, label=label)
        told = [f"{value:.2f}" if np.isfinite(value) else "incomplete" for value in values]
        axes.bar_label(bars, told, fontsize=7, padding=3)
    axes.set_yticks(place, [f"{rung.run}: {rung.adds}" for rung in rungs], fontsize=8)
    axes.invert_yaxis()
    axes.set(xlabel="ATE [m]", xscale="log")
    axes.margins(x=0.15)
    axes.legend(loc="lower right", fontsize=8)
    return figure


def accuracy_against_time(runs: Mapping[str, Run], evaluation: Evaluation, *, key: str) -> Figure:
    """Error against the time that it took, a point for each complete run."""
    figure = Figure(figsize=(9, 4.5), layout="constrained")
    axes = figure.subplots()
    for name in runs:
        error, seconds = evaluation.value(name, key), evaluation.value(name, "total_time_s")
        if error is None or seconds is None or not runs[name].complete:
            continue
        axes.plot(seconds, error, "o", ms=9, color=colours(runs)[name])
        axes.annotate(name, (seconds, error), xytext=(8, 4), textcoords="offset points", fontsize=9)
    axes.set(xlabel="total time [s]", ylabel="ATE [m]", xscale="log", yscale="log")
    axes.margins(0.2)
    axes.grid(alpha=0.3, which="both", lw=0.4)
    return figure
