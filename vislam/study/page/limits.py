"""What waiting buys, lag by lag, and how near estimators come to the bound: tables, figures, sentences."""

from collections.abc import Iterator

import numpy as np
from matplotlib.figure import Figure

from vislam.base.types import IntArray
from vislam.evaluation.lag import LagScores, half_time
from vislam.evaluation.metric import LAG_METRICS, METRICS, MetricSpec, at_lag
from vislam.report.canvas import legend, new_figure
from vislam.report.colours import colours
from vislam.report.table import Table
from vislam.study.answers import mean
from vislam.study.intervals import Estimate
from vislam.study.page.labels import metric_label, parameter_label, plain, with_interval
from vislam.study.trials import Trials

PERIOD = "frame_period_s"
BOUND = tuple(key for key in METRICS if key.startswith("bound_"))
"""Metrics against the bound."""
_EXCESS = ("bound_excess_rotation", "bound_excess_position")
_LINEAR = 1.0
"""Excess within which its axis is linear [%]."""


def keys_of_lags(lags: tuple[int, ...]) -> list[str]:
    """Keys of all metrics of the poses as known at some lags."""
    labels = [*map(str, lags), "all"] if lags else []
    return [at_lag(key, label) for key in LAG_METRICS for label in labels] + ([PERIOD] if lags else [])


def lags_table(trials: Trials) -> Table:
    """A row for each point, estimator and lag: means over the trials, with their intervals."""
    specs = _specs(trials)
    rows = []
    for point, at in trials.groups():
        for name in trials.complete:
            for lag in lag_means(trials, name, rows=at):
                found = [mean(trials, name, at_lag(spec.key, lag.label), rows=at) for spec in specs]
                seconds = "all" if lag.seconds is None else f"{lag.seconds:.2f}"
                cells = [name, *map(plain, point.values()), lag.label, seconds]
                rows.append([*cells, *(with_interval(one) for one in found)])
    header = ["estimator", *map(parameter_label, trials.point), "lag [frames]", "lag [s]"]
    return Table([*header, *(f"mean {spec.short_label}" for spec in specs)], rows)


def lag_means(trials: Trials, name: str, *, rows: IntArray) -> list[LagScores]:
    """Mean of each metric of an estimator at each lag, the shortest first; none if it has no lags."""
    period = mean(trials, name, PERIOD, rows=rows) if PERIOD in _held(trials) else None
    found = []
    for label in _labels(trials) if period is not None else []:
        means = {key: mean(trials, name, at_lag(key, label), rows=rows) for key in LAG_METRICS}
        known = {key: one.value for key, one in means.items() if one is not None}
        if known and period is not None:
            frames = None if label == "all" else int(label)
            found.append(LagScores(frames, None if frames is None else period.value * frames, known, None))
    return found


def lag_curve(trials: Trials) -> Figure | None:
    """Mean of each metric over the lag, with its interval, a line an estimator."""
    specs, labels, rows = _specs(trials), _labels(trials), np.arange(len(trials))
    if not specs:
        return None
    figure = new_figure(1.0 + 2.1 * len(specs))
    panels = figure.subplots(len(specs), 1, sharex=True, squeeze=False)[:, 0]
    for axes, spec in zip(panels, specs, strict=True):
        for name, colour in colours(trials.complete).items():
            found = [mean(trials, name, at_lag(spec.key, label), rows=rows) for label in labels]
            place = [index for index, one in enumerate(found) if one is not None]
            known = np.array([(one.value, one.low, one.high) for one in found if one is not None])
            if len(known):
                axes.plot(place, known[:, 0], "o-", ms=4, lw=1.2, color=colour, label=name)
                axes.fill_between(place, known[:, 1], known[:, 2], color=colour, alpha=0.2, lw=0)
        axes.set_ylabel(f"mean {spec.short_title}\n[{spec.unit}]" if spec.unit else spec.short_title, size=8)
        axes.grid(alpha=0.3, lw=0.4)
        if spec.better == "one":
            axes.axhline(1.0, color="k", lw=0.6)
    period = float(np.nanmedian([np.nanmedian(trials.value(name, PERIOD)) for name in _with_lags(trials)]))
    told = ["all" if label == "all" else f"{period * int(label):.2g}" for label in labels]
    panels[-1].set_xticks(range(len(labels)), told)
    panels[-1].set_xlabel("lag [s]")
    legend(figure, panels[0])
    return figure


def waiting(trials: Trials) -> Iterator[str]:
    """Say of each estimator when half of what smoothing buys has come, by the means over all trials."""
    rows = np.arange(len(trials))
    for name in trials.complete:
        lags = lag_means(trials, name, rows=rows)
        for spec in _specs(trials):
            half = half_time(lags, spec.key) if spec.better == "less" else None
            if half is None:
                continue
            when = (
                f"later than {half.longest:.2g} s" if half.seconds is None else f"within {half.seconds:.2g} s"
            )
            ends = f"{half.filtered:.3g} to {half.smoothed:.3g} {spec.unit}"
            yield f"{name}: half of what smoothing takes off the {spec.short_title} ({ends}) comes {when}."
            break


def bound_table(trials: Trials) -> Table:
    """A row for each point and estimator: squared errors over the bound, and the excess over it."""
    keys = [key for key in BOUND if key in _held(trials)]
    rows = []
    for point, at in trials.groups():
        for name in trials.complete:
            found = [mean(trials, name, key, rows=at) for key in keys]
            known = next((one for one in found if one is not None), None)
            if known is not None:
                told = [name, *map(plain, point.values()), str(known.count)]
                rows.append([*told, *(with_interval(one) for one in found)])
    header = ["estimator", *map(parameter_label, trials.point), "trials"]
    return Table([*header, *(f"mean {metric_label(key)}" for key in keys)], rows)


def bound_figure(trials: Trials) -> Figure | None:
    """Mean excess of each estimator over the bound, with its interval."""
    keys = [key for key in _EXCESS if key in _held(trials)]
    if not keys:
        return None
    rows = np.arange(len(trials))
    figure = new_figure(1.4 + 0.5 * len(trials.complete))
    panels = figure.subplots(1, len(keys), sharey=True, squeeze=False)[0]
    for axes, key in zip(panels, keys, strict=True):
        for place, (name, colour) in enumerate(colours(trials.complete).items()):
            found = mean(trials, name, key, rows=rows)
            if found is not None:
                axes.errorbar(found.value, place, xerr=_reach(found), fmt="o", ms=5, capsize=3, color=colour)
        axes.axvline(0.0, color="k", lw=0.8)
        axes.set_xscale("symlog", linthresh=_LINEAR)
        axes.set_xlabel(metric_label(key), size=8)
        axes.grid(alpha=0.3, lw=0.4, axis="x")
    panels[0].set_yticks(range(len(trials.complete)), list(trials.complete))
    panels[0].invert_yaxis()
    return figure


def against_bound(trials: Trials) -> Iterator[str]:
    """Say who comes nearest to the bound, and who is below it, which nobody can be."""
    rows = np.arange(len(trials))
    for key in (key for key in _EXCESS if key in _held(trials)):
        means = {name: mean(trials, name, key, rows=rows) for name in trials.complete}
        known = {name: one for name, one in means.items() if one is not None}
        if not known:
            continue
        best = min(known, key=lambda name: abs(known[name].value))
        what = key.rpartition("_")[2]
        yield (
            f"the mean squared {what} error of {best} is the nearest to the bound, "
            f"{with_interval(known[best], '%')} above it."
        )
        below = [name for name, one in known.items() if one.high < 0.0]
        if below:
            yield (
                f"below the bound of the {what}, by more than chance: {', '.join(below)}. What is biased "
                "can be; else noise, truth and what is told of them do not fit."
            )


def _reach(found: Estimate) -> np.ndarray:
    return np.nan_to_num([[found.value - found.low], [found.high - found.value]])


def _specs(trials: Trials) -> list[MetricSpec]:
    """Metrics that some estimator has at some lag, in the order of the tables."""
    held, labels = _held(trials), _labels(trials)
    return [spec for key, spec in LAG_METRICS.items() if any(at_lag(key, label) in held for label in labels)]


def _labels(trials: Trials) -> list[str]:
    """Lags that some estimator has, the shortest first, ``all`` last."""
    parts = (key.rpartition("_lag_") for key in _held(trials))
    found = {label for stem, _, label in parts if stem in LAG_METRICS}
    return sorted(found, key=lambda label: np.inf if label == "all" else int(label))


def _held(trials: Trials) -> set[str]:
    """Keys of the metrics that were kept and are there."""
    return {key for _, key, _ in trials.values}


def _with_lags(trials: Trials) -> list[str]:
    return [name for name in trials.complete if np.isfinite(trials.value(name, PERIOD)).any()]
