"""What the figures of all pages have in common: width, legible letters, plain numbers on axes."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter, LogLocator

from vislam.base.types import Array, IntArray
from vislam.report.decimation import at_most, evenly, extremes
from vislam.report.margins import Margins

WIDTH = 6.4
"""Width of a figure [inch]."""
SMALL = 9
"""Smallest letters [pt]."""
TIME = "time [s]"
"""Label of the abscissa that a page can turn into the distance travelled."""
_GAP = 5.0
"""Times the median distance of samples from which on a line is broken."""
_BAND = 400
"""Points of a band at most: one a point of the figure's width."""
_COLUMNS = 800
"""Places that are told apart along the width of a figure: two a point."""
_MARKS = 2500
"""Marks of a panel at most, which are elements of a page each."""
_MARGIN = 0.06
"""Room above and below the lines, as a share of what they span."""


class PlainLog(LogFormatter):
    """Labels of a logarithmic axis without powers, whose exponents would be too small to read."""

    def __call__(self, x: float, pos: int | None = None) -> str:
        """Label at a value; empty where there is to be none."""
        return f"{x:g}" if super().__call__(x, pos) else ""


class _Between(LogLocator):
    """Ticks between the powers of ten: at 2 and 5, and within a decade at all digits."""

    def tick_values(self, vmin: float, vmax: float) -> Sequence[float]:
        """Where they are."""
        self.set_params(subs=(2.0, 5.0) if vmax > 10.0 * vmin else [float(digit) for digit in range(2, 10)])
        return super().tick_values(vmin, vmax)


def new_figure(height: float) -> Figure:
    """An empty figure of a height [inch]."""
    return Figure(figsize=(WIDTH, height), layout=Margins())


def panels(rows: int, height: float) -> tuple[Figure, list[Axes]]:
    """Figure of panels below each other, with one abscissa."""
    figure = new_figure(height)
    return figure, list(figure.subplots(rows, 1, sharex=True, squeeze=False)[:, 0])


def logarithmic(axes: Axes, which: str = "y") -> None:
    """Make an axis logarithmic, with plain numbers."""
    for name in which:
        getattr(axes, f"set_{name}scale")("log")
        axis = getattr(axes, f"{name}axis")
        axis.set_major_formatter(PlainLog())
        axis.set_minor_locator(_Between())
        axis.set_minor_formatter(PlainLog(minor_thresholds=(1.0, 0.4)))


def line(axes: Axes, x: Array, y: Array, **how: Any) -> None:
    """Draw a line that is broken where samples are missing, instead of one that says something of the gaps.

    Parameters
    ----------
    axes : Axes
    x, y : (n,)
        x increasing.
    **how
        As of :meth:`matplotlib.axes.Axes.plot`.
    """
    step = np.diff(x)
    gaps = np.flatnonzero(step > _GAP * np.median(step)) + 1 if len(step) else np.empty(0, int)
    axes.plot(np.insert(x, gaps, np.nan), np.insert(np.asarray(y, float), gaps, np.nan), **how)


def band(axes: Axes, x: Array, low: Array, high: Array, **how: Any) -> None:
    """Fill what lies between two lines, ``(n,)`` each; of many points, between extremes of some at a time."""
    first = evenly(len(x), _BAND)
    if len(first):
        low, high = np.fmin.reduceat(low, first), np.fmax.reduceat(high, first)
    axes.fill_between(x[first], low, high, lw=0, **how)


def area(axes: Axes, x: Array, y: Array | IntArray, **how: Any) -> None:
    """Fill what lies below a line, ``(n,)`` each, through its extremes where there are many points."""
    rows = extremes(x, y, _COLUMNS)
    axes.fill_between(x[rows], y[rows], lw=0, **how)


def marks(axes: Axes, points: Array, **how: Any) -> None:
    """Mark points ``(n, 2)`` in a panel whose limits are set; of many, those that can be told apart."""
    ends = np.array([axes.get_xlim(), axes.get_ylim()])
    rows = at_most(points, _MARKS, float(np.ptp(ends, axis=1).max()) / _COLUMNS)
    axes.plot(*points[rows].T, ".", **how)


def legend(figure: Figure, *axes: Axes, columns: int = 3) -> None:
    """One legend above the panels, a name once, so that no line is hidden by it."""
    found: dict[str, Any] = {}
    for one in axes:
        for handle, name in zip(*one.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    if found:
        handles, names = list(found.values()), list(found)
        figure.legend(handles, names, loc="upper left", ncols=columns, fontsize=SMALL, frameon=False)
        engine = figure.get_layout_engine()
        assert isinstance(engine, Margins)
        engine.leave(-(-len(names) // columns), size=SMALL)


def limit(axes: Axes, wanted: Iterable[Array], leaving: Iterable[tuple[str, str, Array]]) -> None:
    """Scale a panel by the wanted lines alone, and say how far those reach that leave it.

    Parameters
    ----------
    axes : Axes
    wanted : iterable of (n,)
        Values of the lines that set the scale.
    leaving : iterable of (name, colour, (n,))
        The others.
    """
    known = np.concatenate([np.asarray(values)[np.isfinite(values)] for values in wanted] or [np.empty(0)])
    if not len(known):
        return
    low, high = float(known.min()), float(known.max())
    room = _MARGIN * (high - low) or 0.5
    low, high = low - room, high + room
    axes.set_ylim(low, high)
    height = 0.96
    for name, colour, values in leaving:
        far = np.asarray(values)[np.isfinite(values)]
        if not len(far) or (far.min() >= low and far.max() <= high):
            continue
        end = far.max() if far.max() - high > low - far.min() else far.min()
        text = f"{name}: to {end:.3g}"
        axes.text(
            0.99, height, text, color=colour, transform=axes.transAxes, ha="right", va="top", size=SMALL
        )
        height -= 0.16
