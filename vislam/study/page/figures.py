"""Figures of a study: trials in, Figure out."""

from collections.abc import Callable, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vislam.base.types import Array, IntArray
from vislam.evaluation.metric import METRICS
from vislam.report.canvas import legend, logarithmic, new_figure
from vislam.report.colours import colours
from vislam.report.figures import Drawing
from vislam.study.answers import NEES, failure_rate, median, pooled_nees
from vislam.study.intervals import Estimate
from vislam.study.page.labels import TIME, errors, metric_label, parameter_label, plain
from vislam.study.page.limits import bound_figure, lag_curve
from vislam.study.page.maps import heat_map
from vislam.study.trials import Trials, is_number

_WIDE = 20.0
"""Ratio of the largest to the smallest positive value from which on an axis is logarithmic."""
_ROOM = 0.7
"""Share of the room between two columns that the estimators take."""


def all_figures(trials: Trials) -> dict[str, Drawing]:
    """Every figure that can be drawn of a study, by file name: of the filtered and of the smoothed apart."""
    found = {}
    for name, (draw, title, caption) in FIGURES.items():
        parts = {name: (title, trials)}
        if name not in _OF_RUNS:
            parts = {f"{name}_{one}": (f"{title}, {one}", trials.of(one)) for one in trials.estimates}
        for file, (titled, part) in parts.items():
            figure = draw(part)
            if figure is not None:
                found[file] = Drawing(titled, caption, figure)
    return found


def response(trials: Trials) -> Figure | None:
    """Headline error and NEES over each swept parameter, with the intervals of the estimators as bands."""
    paths = [path for path in trials.point if len(trials.levels(path)) > 1]
    keys = [*errors(trials)[:1], *([NEES] if trials.has(NEES) else [])]
    if not paths or not keys:
        return None
    figure = new_figure(0.6 + 2.9 * len(keys) * len(paths))
    panels = figure.subplots(len(keys) * len(paths), 1, squeeze=False)[:, 0]
    cells = [(path, key) for path in paths for key in keys]
    for axes, (path, key) in zip(panels, cells, strict=True):
        _curves(axes, trials, path, key)
    legend(figure, panels[0])
    return figure


def _curves(axes: Axes, trials: Trials, path: str, key: str) -> None:
    levels = trials.levels(path)
    place = _places(axes, levels)
    for name, colour in colours(trials.complete).items():
        found = [_centre(trials, name, key, trials.at({path: value})) for value in levels]
        value, low, high = _columns(found)
        if not np.isfinite(value).any():
            continue
        axes.fill_between(place, low, high, color=colour, alpha=0.18, lw=0)
        axes.plot(place, value, "o-", ms=4, lw=1.2, color=colour, label=name)
    label = METRICS[NEES].title if key == NEES else f"median {metric_label(key)}"
    axes.set(xlabel=parameter_label(path), ylabel=label)
    logarithmic(axes)
    if key == NEES:
        axes.axhline(1.0, color="k", lw=0.6)


def _centre(trials: Trials, name: str, key: str, rows: IntArray) -> Estimate | None:
    """Mean of the NEES, which a bound is known of; median of an error, which one bad trial does not rule."""
    if key == NEES:
        found = pooled_nees(trials, name, rows=rows)
        return None if found is None else found.mean
    return median(trials, name, key, rows=rows)


def nees(trials: Trials) -> Figure | None:
    """NEES of each trial, and its mean with the interval, by estimator."""
    if not trials.has(NEES):
        return None
    figure = new_figure(4.2)
    axes = figure.subplots()
    columns = _by_column(axes, trials)
    for place, name, colour, rows in _dodged(trials, columns):
        values = trials.value(name, NEES)[rows]
        known = values[np.isfinite(values)]
        found = pooled_nees(trials, name, rows=rows)
        if found is None:
            continue
        spread = 0.25 * _ROOM / len(trials.complete) * np.linspace(-1.0, 1.0, len(known))
        axes.plot(place + spread, known, ".", ms=3, color=colour, alpha=0.5, rasterized=True)
        _marked(axes, place, found.mean, colour=colour, name=name)
    axes.axhline(1.0, color="k", lw=0.6)
    axes.set(ylabel=METRICS[NEES].title)
    logarithmic(axes)
    legend(figure, axes)
    return figure


def failures(trials: Trials) -> Figure | None:
    """Share of the runs that did not finish, with its interval, by estimator; None if all did."""
    if not any(np.any(trials.done & ~complete) for complete in trials.complete.values()):
        return None
    figure = new_figure(3.6)
    axes = figure.subplots()
    columns = _by_column(axes, trials)
    for place, name, colour, rows in _dodged(trials, columns):
        found = failure_rate(trials, name, rows=rows)
        if found is not None:
            _marked(axes, place, found, colour=colour, name=name)
    axes.set(ylabel="share of runs that failed", ylim=(-0.02, 1.02))
    legend(figure, axes)
    return figure


def cost(trials: Trials) -> Figure | None:
    """Error against the time of a step, a point for each estimator, and the Pareto front."""
    key = next(iter(errors(trials)), None)
    if key is None:
        return None
    rows, points = np.arange(len(trials)), {}
    for name in trials.complete:
        time, error = median(trials, name, TIME, rows=rows), median(trials, name, key, rows=rows)
        if time is not None and error is not None:
            points[name] = (time, error)
    if not points:
        return None
    figure = new_figure(4.2)
    axes = figure.subplots()
    best = front([(time.value, error.value) for time, error in points.values()])
    axes.step(best[:, 0], best[:, 1], where="post", color="k", lw=0.8, ls="--", label="front")
    for name, colour in colours(trials.complete).items():
        if name in points:
            time, error = points[name]
            at = (time.value, error.value)
            axes.errorbar(*at, xerr=_reach(time), yerr=_reach(error), fmt="o", ms=6, lw=1.2, color=colour)
            axes.annotate(name, at, xytext=(8, 5), textcoords="offset points", fontsize=9)
    axes.set(xlabel=f"median {metric_label(TIME)}", ylabel=f"median {metric_label(key)}")
    logarithmic(axes, "xy")
    axes.margins(0.2)
    axes.grid(alpha=0.3, which="both", lw=0.4)
    legend(figure, axes)
    return figure


def front(points: Sequence[tuple[float, float]]) -> Array:
    """Points ``(m, 2)`` that no other is below in both, by the first."""
    ordered = np.array(sorted(points))
    before = np.minimum.accumulate(np.concatenate([[np.inf], ordered[:-1, 1]]))
    return np.asarray(ordered[ordered[:, 1] < before])


def _places(axes: Axes, levels: Sequence[object]) -> Array:
    """Where values of a parameter stand on the horizontal axis: numbers at themselves, words in a row."""
    if not all(is_number(value) for value in levels):
        axes.set_xticks(range(len(levels)), [plain(value) for value in levels])
        return np.arange(float(len(levels)))
    place = np.array(levels, dtype=float)
    if place.min() > 0.0 and place.max() > _WIDE * place.min():
        logarithmic(axes, "x")
    return place


def _by_column(axes: Axes, trials: Trials) -> list[IntArray]:
    """Rows of each column of a figure: a value of the one swept parameter, or else all trials."""
    if len(trials.point) != 1:
        axes.set_xticks([])
        return [np.arange(len(trials))]
    (path,) = trials.point
    levels = trials.levels(path)
    axes.set_xticks(range(len(levels)), [plain(value) for value in levels])
    axes.set_xlabel(parameter_label(path))
    return [trials.at({path: value}) for value in levels]


def _dodged(trials: Trials, columns: Sequence[IntArray]) -> list[tuple[float, str, str, IntArray]]:
    """Place, estimator, colour and rows of everything that is drawn, side by side in each column."""
    width = _ROOM / len(trials.complete)
    return [
        (column - 0.5 * _ROOM + (index + 0.5) * width, name, colour, rows)
        for column, rows in enumerate(columns)
        for index, (name, colour) in enumerate(colours(trials.complete).items())
    ]


def _marked(axes: Axes, place: float, found: Estimate, *, colour: str, name: str) -> None:
    """Draw a number with its interval; the first of an estimator goes into the legend."""
    label = None if name in axes.get_legend_handles_labels()[1] else name
    axes.errorbar(
        place, found.value, yerr=_reach(found), fmt="o", ms=5, capsize=3, lw=1.4, color=colour, label=label
    )


def _reach(found: Estimate) -> Array:
    """Lengths of an interval below and above its value ``(2, 1)``."""
    ends = [[found.value - found.low], [found.high - found.value]]
    return np.maximum(np.nan_to_num(ends), 0.0)


def _columns(found: Sequence[Estimate | None]) -> Array:
    """Values, low and high ends ``(3, n)``, NaN where there is none."""
    rows = [(np.nan,) * 3 if one is None else (one.value, one.low, one.high) for one in found]
    return np.array(rows).T


_OF_RUNS = ("failures", "lag_curve")
"""Figures of runs as a whole."""
FIGURES: dict[str, tuple[Callable[[Trials], Figure | None], str, str]] = {
    "response": (
        response,
        "Response",
        "Median error and mean NEES over what was swept, with 95 % intervals as bands. Over one parameter, "
        "all values of the others are taken together.",
    ),
    "heat_map": (
        heat_map,
        "Over both parameters",
        "Median error of each estimator at each point, all on one scale. A point where no run finished is "
        "empty.",
    ),
    "nees": (
        nees,
        "Consistency",
        "Normalised squared error of the pose per degree of freedom: a dot for the average of each trial, "
        "and their mean with its 95 % interval. Above 1 an estimator is overconfident.",
    ),
    "bound": (
        bound_figure,
        "Excess over the bound",
        "By how much the mean squared error of each estimator exceeds the least there can be, with its 95 % "
        "interval; the axis is linear to 1 %. 0 is the bound itself.",
    ),
    "lag_curve": (
        lag_curve,
        "What waiting buys",
        "Mean of each metric of the poses as known some time later, from the filtered ones at 0 to the "
        "smoothed ones of all data, with 95 % intervals as bands.",
    ),
    "failures": (
        failures,
        "Failures",
        "Share of the runs that did not finish, with its 95 % interval, of the trials that were carried out.",
    ),
    "cost": (
        cost,
        "Accuracy against time",
        "Median error and median time of a step over all trials, with 95 % intervals. Nobody is both faster "
        "and closer than an estimator on the dashed front.",
    ),
}
"""What draws each figure (None where the trials do not have it), its title and its caption."""
