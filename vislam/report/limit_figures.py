"""Figures of what waiting buys, lag by lag, and of how near errors come to the bound."""

import numpy as np
from matplotlib.figure import Figure

from vislam.base.legible import literal
from vislam.evaluation.metric import LAG_METRICS
from vislam.report.canvas import SMALL, TIME, legend, logarithmic, new_figure
from vislam.report.shown import Shown


def lag_curve(shown: Shown) -> Figure | None:
    """Each metric of the poses as known at a lag, over the lags, a line an estimator."""
    scored = {name: shown.evaluation.scores[name].lags for name in shown.runs}
    scored = {name: lags for name, lags in scored.items() if lags}
    if not scored:
        return None
    found = {key for lags in scored.values() for lag in lags for key in lag.values}
    specs = [spec for key, spec in LAG_METRICS.items() if key in found]
    if not specs:
        return None
    figure = new_figure(1.0 + 2.1 * len(specs))
    rows = figure.subplots(len(specs), 1, sharex=True, squeeze=False)[:, 0]
    labels = list(
        dict.fromkeys(lag.label for lags in scored.values() for lag in lags if lag.frames is not None)
    )
    labels = [*sorted(labels, key=int), "all"]
    seconds = {lag.label: lag.seconds for lags in scored.values() for lag in lags}
    for axes, spec in zip(rows, specs, strict=True):
        for name, lags in scored.items():
            known = [
                (labels.index(lag.label), lag.values[spec.key]) for lag in lags if spec.key in lag.values
            ]
            place, value = np.array(known).reshape(-1, 2).T
            axes.plot(place, value, "o-", ms=4, lw=1.2, color=shown.colour(name), label=literal(name))
        axes.set(ylabel=f"{spec.short_title}\n[{spec.unit}]" if spec.unit else spec.short_title)
        axes.yaxis.label.set_fontsize(SMALL)
        axes.grid(alpha=0.3, lw=0.4)
        if spec.better == "one":
            logarithmic(axes)
            axes.axhline(1.0, color="k", lw=0.6)
    told = ["all" if (at := seconds[label]) is None else f"{at:.2g}" for label in labels if label in seconds]
    rows[-1].set_xticks(range(len(told)), told)
    rows[-1].set_xlabel("lag [s]")
    legend(figure, rows[0])
    return figure


def bound(shown: Shown) -> Figure | None:
    """Errors of rotation and position over time, and the least there can be."""
    scores = {name: one.efficiency for name, one in shown.scores.items()}
    known = {name: one for name, one in scores.items() if one is not None}
    if not known:
        return None
    figure = new_figure(5.0)
    rows = figure.subplots(2, 1, sharex=True)
    for axes, (part, scale, unit) in zip(
        rows, (("rotation", np.rad2deg(1.0), "deg"), ("position", 1.0, "m")), strict=True
    ):
        for name, one in known.items():
            time = shown.record.stamp[one.frame] - shown.record.stamp[0]
            axes.plot(time, scale * one.length(part), lw=1.0, color=shown.colour(name), label=literal(name))
        longest = max(known.values(), key=lambda one: len(one.frame))
        time = shown.record.stamp[longest.frame] - shown.record.stamp[0]
        axes.plot(time, scale * longest.least_sigma(part), color="k", lw=1.6, label="bound (rms)")
        axes.set(ylabel=f"{part} error [{unit}]", yscale="log")
        axes.grid(alpha=0.3, lw=0.4)
    rows[-1].set_xlabel(TIME)
    legend(figure, rows[0])
    return figure
