"""Figures of :mod:`benchmarks.filter_consistency`: data in, Figure out."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

from benchmarks.variants import of_disparity
from vislam.evaluation.consistency import COMPONENTS

if TYPE_CHECKING:
    from benchmarks.filter_consistency import Summary

# Okabe and Ito's colours, which the colour-blind can tell apart: one for each way of filtering.
_COLOURS = {
    "dead_reckoning": "0.5",
    "ekf": "#D55E00",
    "ekf_iterated": "#E69F00",
    "ekf_fej": "#0072B2",
    "ekf_invariant": "#009E73",
    "eks": "#CC79A7",
}
_MOTIONS = {
    3: ("move along x", "1/m$^2$"),
    4: ("move along y", "1/m$^2$"),
    5: ("move along z", "1/m$^2$"),
    2: ("turn about z (yaw)", "1/rad$^2$"),
}
"""Motions of the world that are shown: those that stay unobservable under gravity."""


def all_figures(found: "Mapping[str, Summary]", *, title: str) -> dict[str, Figure]:
    """Every figure of one level of noise, by file name."""
    return {
        "anees": anees(found, title=title),
        "coverage": coverage(found, title=title),
        "observability": observability(found, title=title),
    }


def anees(found: "Mapping[str, Summary]", *, title: str) -> Figure:
    """Average NEES of the pose over time, landmarks as points above and as disparities below."""
    figure = Figure(figsize=(9, 8), layout="constrained")
    rows: list[Axes] = list(figure.subplots(2, 1, sharex=True, sharey=True))
    for axes, disparity in zip(rows, (False, True), strict=True):
        for name, one in found.items():
            if of_disparity(name) == disparity:
                axes.plot(one.anees["pose"].value, lw=1.2, color=_colour(name), label=name)
        widest = max(found.values(), key=lambda one: one.anees["pose"].high).anees["pose"]
        axes.axhspan(
            widest.low, widest.high, color="0.85", lw=0, label="95 % interval of a consistent filter"
        )
        axes.axhline(1.0, color="k", lw=0.6)
        axes.set(yscale="log", ylabel="pose NEES per degree of freedom")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(ScalarFormatter())
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.set_title("landmarks as disparities" if disparity else "landmarks as points", fontsize=10)
        axes.legend(loc="upper left", fontsize=8, ncols=2)
    rows[-1].set_xlabel("frame")
    figure.suptitle(f"Average over drives: {title}")
    return figure


def coverage(found: "Mapping[str, Summary]", *, title: str) -> Figure:
    """Share of errors within three standard deviations, a group of bars for each component."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    width = 0.85 / len(found)
    for index, (name, one) in enumerate(found.items()):
        axes.bar(
            np.arange(len(COMPONENTS)) + (index - 0.5 * (len(found) - 1)) * width,
            100.0 * one.coverage,
            width,
            color=_colour(name),
            hatch="///" if of_disparity(name) else None,
            edgecolor="white",
            lw=0.4,
            label=name,
        )
    lowest = min(float(one.coverage.min()) for one in found.values())
    axes.axhline(99.73, color="k", lw=0.8, label="of consistent filters (99.73 %)")
    axes.set(
        ylim=(max(100.0 * lowest - 3.0, 0.0), 100.5), ylabel="errors within three standard deviations [%]"
    )
    axes.set_xticks(np.arange(len(COMPONENTS)), COMPONENTS)
    axes.set_title(f"3-sigma coverage by component of the pose: {title}", fontsize=10)
    axes.legend(loc="lower center", fontsize=8, ncols=4, bbox_to_anchor=(0.5, -0.32))
    return figure


def observability(found: "Mapping[str, Summary]", *, title: str) -> Figure:
    """Information that the filters believe to gain of where the world is."""
    figure = Figure(figsize=(10, 7), layout="constrained")
    panels: list[Axes] = list(figure.subplots(2, 2, sharex=True).reshape(-1))
    for axes, (motion, (label, unit)) in zip(panels, _MOTIONS.items(), strict=True):
        for name, one in found.items():
            if one.gained is not None:
                # Nothing is gained before a landmark is seen again, and a logarithm has no zero.
                gained = np.where(one.gained[:, motion] > 0.0, one.gained[:, motion], np.nan)
                style = "--" if of_disparity(name) else "-"
                axes.plot(gained, style, lw=1.4, color=_colour(name), label=name)
        axes.set(yscale="log", title=label, ylabel=f"information gained [{unit}]")
    for axes in panels[2:]:
        axes.set_xlabel("frame")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", fontsize=8, ncols=4)
    figure.suptitle(
        "Information from nowhere on motions of the whole world (the lower curves are rounding):\n" + title,
        fontsize=11,
    )
    return figure


def _colour(name: str) -> str:
    return _COLOURS[name.split(",", maxsplit=1)[0]]
