"""Figures of errors: segments by length, steps of an ablation chain, accuracy against time."""

import numpy as np
from matplotlib.figure import Figure

from vislam.base.legible import literal
from vislam.core.run import Estimate
from vislam.evaluation.evaluate import headline
from vislam.evaluation.metric import ESTIMATE_TITLES, METRICS
from vislam.report.canvas import SMALL, legend, logarithmic, new_figure
from vislam.report.colours import COLOURS
from vislam.report.shown import Shown

_WIDTH = 0.8
"""Share of the room between two lengths that their boxes take."""


def segment_errors(shown: Shown) -> Figure | None:
    """Relative errors by the length of the segments, a box an estimator: quartiles, and 5 to 95 %."""
    trajectories = {name: one.trajectory for name, one in shown.scores.items()}
    scores = {name: one for name, one in trajectories.items() if one is not None and one.by_distance}
    if not scores:
        return None
    figure = new_figure(4.0)
    axes = figure.subplots()
    lengths = sorted({length for one in scores.values() for length in one.by_distance})
    width = _WIDTH / max(len(scores), 1)
    for index, (name, one) in enumerate(scores.items()):
        there = [place for place, length in enumerate(lengths) if length in one.by_distance]
        colour = shown.colour(name)
        drawn = axes.boxplot(
            [one.by_distance[lengths[place]].translation_error for place in there],
            positions=[place - 0.5 * _WIDTH + (index + 0.5) * width for place in there],
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
        drawn["boxes"][0].set_label(literal(name))
    axes.set_xticks(range(len(lengths)), [f"{length:g} m" for length in lengths])
    axes.set(xlabel="length of the segment", ylabel="translation error [m]")
    logarithmic(axes)
    legend(figure, axes)
    return figure


def ablation_chain(shown: Shown) -> Figure | None:
    """Error of each step, of its filtered and of its smoothed poses."""
    steps = shown.steps
    if not steps:
        return None
    figure = new_figure(0.9 + 0.5 * len(steps))
    axes = figure.subplots()
    place = np.arange(len(steps))
    spec = METRICS[steps[0].key]
    drawn: tuple[tuple[Estimate, float, str], ...] = (
        ("filtered", -0.2, COLOURS[5]),
        ("smoothed", 0.2, COLOURS[0]),
    )
    for estimate, offset, colour in drawn:
        values = [np.nan if (value := getattr(step, estimate)) is None else value for step in steps]
        bars = axes.barh(place + offset, values, height=0.38, color=colour, label=ESTIMATE_TITLES[estimate])
        missing = "incomplete" if estimate == "filtered" else ""
        told = [f"{value:.{spec.digits}f}" if np.isfinite(value) else missing for value in values]
        axes.bar_label(bars, told, fontsize=SMALL, padding=3)
    axes.set_yticks(place, [literal(f"{step.run}: {step.adds}") for step in steps], fontsize=SMALL)
    axes.invert_yaxis()
    axes.set(xlabel=spec.label)
    logarithmic(axes, "x")
    axes.margins(x=0.15)
    legend(figure, axes)
    return figure


def accuracy_against_time(shown: Shown) -> Figure | None:
    """Error against the time that it took, a point for each complete run."""
    key = "held_out_median" if shown.reference is None else headline(shown.reference)
    time = "total_time_s"
    figure = new_figure(4.0)
    axes = figure.subplots()
    for name, run in shown.runs.items():
        error, seconds = (shown.evaluation.value(name, one, shown.estimate) for one in (key, time))
        if error is None or seconds is None or not run.complete:
            continue
        axes.plot(seconds, error, "o", ms=9, color=shown.colour(name), label=literal(name))
    axes.set(xlabel=METRICS[time].label, ylabel=METRICS[key].label)
    logarithmic(axes, "xy")
    if not axes.lines:
        return None
    axes.margins(0.2)
    axes.grid(alpha=0.3, which="both", lw=0.4)
    legend(figure, axes)
    return figure
