"""Figure of :mod:`benchmarks.smoother_settings`: data in, Figure out."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vislam.base.types import Array

_WINDOW = 25
# Okabe and Ito's colours, which the colour-blind can tell apart; one a kind of setting.
_COLOURS = {
    "shipped": "k",
    "relinearize_every": "#0072B2",
    "landmark_threshold": "#D55E00",
    "wildfire_threshold": "#009E73",
    "factorization": "#CC79A7",
}
_STYLES = ("-", "--", "-.", ":", (0, (1, 3)))
_MARKERS = "osv^D"


def steps(step_time: Mapping[str, Array], distance: Mapping[str, float], *, title: str) -> Figure:
    """Time of a step over the drive, and its mean against the distance to the converged estimate [m]."""
    figure = Figure(figsize=(12, 5), layout="constrained")
    left: Axes
    right: Axes
    left, right = figure.subplots(1, 2)
    seen: dict[str, int] = {}
    for name, seconds in step_time.items():
        kind = name.split(":", maxsplit=1)[0]
        index = seen[kind] = seen.get(kind, -1) + 1
        look: dict[str, Any] = {
            "color": _COLOURS[kind],
            "label": name,
            "zorder": 3.0 if kind == "shipped" else 2.0,
        }
        window = min(_WINDOW, len(seconds))
        mean = np.convolve(1e3 * seconds, np.full(window, 1.0 / window), mode="valid")
        frame = np.arange(len(mean)) + 0.5 * (window - 1)
        left.plot(frame, mean, ls=_STYLES[index], lw=1.8 if kind == "shipped" else 1.0, **look)
        right.plot(1e3 * seconds.mean(), distance[name], _MARKERS[index], ms=7, **look)
    left.set(
        xlabel="frame",
        ylabel=f"time of a step, mean over {_WINDOW} frames [ms]",
        yscale="log",
        title="cost along the drive",
    )
    right.set(
        xlabel="time of a step, mean [ms]",
        ylabel="distance to the converged estimate, RMSE [m]",
        xscale="log",
        yscale="log",
        title="cost against what is left to converge",
    )
    for axes in (left, right):
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("")
        axes.grid(which="both", color="0.9", lw=0.5)
    right.xaxis.set_major_formatter("{x:g}")
    right.xaxis.set_minor_formatter("{x:g}")
    figure.legend(*right.get_legend_handles_labels(), loc="outside lower center", fontsize=8, ncols=4)
    figure.suptitle(title, fontsize=11)
    return figure
