"""Layout of a figure from the lengths of its labels, without drawing it.

Matplotlib's own engines draw every label to measure it, several times: a third of the time of a page.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.layout_engine import LayoutEngine
from matplotlib.text import Text

from vislam.base.types import Array

_EM = 0.62
"""Width of a letter, as a share of its size; digits have 0.636, a point half of that."""
_LINE = 1.25
"""Height of a line, as a share of its size."""
_SIZE = 10.0
"""Size of letters that have no other [pt]."""
_TICK = 8.0
"""Length of a tick and its distance from the label [pt]."""
_PAD = 5.0
"""Distance of a label from the labels of the ticks, and least distance from the figure's edge [pt]."""
_BAR = (0.6, 40.0)
"""Share of the figure's width that a bar of colours takes, and times its height that it is long."""


class Margins(LayoutEngine):
    """Panels in a grid, below a legend and a title, above a bar of colours; as large as there is room."""

    _adjust_compatible = False
    _colorbar_gridspec = False

    def __init__(self) -> None:
        super().__init__()
        self._above = 0.0

    def leave(self, lines: int, *, size: float) -> None:
        """Leave room above the panels for the lines of a legend, whose letters have a size [pt]."""
        self._above = size * (1.1 * lines + 0.5 * (lines - 1) + 1.3)

    def execute(self, fig: Figure) -> None:
        """Place all axes of a figure."""
        width, height = 72.0 * fig.get_figwidth(), 72.0 * fig.get_figheight()
        grid = [axes for axes in fig.axes if axes.get_subplotspec() is not None and axes.axison]
        bars = [axes for axes in fig.axes if axes.get_subplotspec() is None]
        if not grid:
            return
        low = _below_bars(bars, width, height)
        title = _LINE * _SIZE + _PAD if fig.get_suptitle() else 0.0
        top = height - max(self._above, title)
        columns = _Track.of(grid, "colspan", lambda axes: (_left(axes), _right(axes)))
        rows = _Track.of(grid, "rowspan", lambda axes: (_above(axes), _below(axes)))
        for axes in grid:
            spec = axes.get_subplotspec()
            assert spec is not None
            left, right = columns.ends(spec.colspan, width)
            above, below = rows.ends(spec.rowspan, top - low)
            place = [left / width, (top - below) / height, (right - left) / width, (below - above) / height]
            axes.set_position((place[0], place[1], max(place[2], 0.01), max(place[3], 0.01)))


class _Track:
    """Columns from the left, or rows from the top: all as wide, with room for what stands beside them."""

    def __init__(self, before: Array, after: Array) -> None:
        self._before, self._after = before, after

    @classmethod
    def of(cls, grid: Sequence[Axes], span: str, sides: Any) -> "_Track":
        """Room before and after each, by the axes that begin and end there."""
        spans = [getattr(axes.get_subplotspec(), span) for axes in grid]
        before, after = np.zeros((2, max(one.stop for one in spans)))
        for axes, one in zip(grid, spans, strict=True):
            first, last = sides(axes)
            before[one.start] = max(before[one.start], first)
            after[one.stop - 1] = max(after[one.stop - 1], last)
        return cls(before, after)

    def ends(self, span: range, whole: float) -> tuple[float, float]:
        """Where panels of a span begin and end [pt]."""
        beside = self._before + self._after
        each = (whole - beside.sum()) / len(beside)
        begin = beside[: span.start].sum() + span.start * each + self._before[span.start]
        last = span.stop - 1
        return float(begin), float(beside[:last].sum() + last * each + self._before[last] + each)


def _left(axes: Axes) -> float:
    return _PAD + _ticks(axes.yaxis, "labelleft", across=True) + _label(axes.yaxis.label)


def _below(axes: Axes) -> float:
    return _PAD + _ticks(axes.xaxis, "labelbottom", across=False) + _label(axes.xaxis.label)


def _right(axes: Axes) -> float:
    # Half of the last label of the abscissa stands out.
    shown = axes.xaxis.get_tick_params().get("labelbottom", True)
    return 8.0 + (0.5 * _width(_told(axes.xaxis)[-1:], _size(axes.xaxis)) if shown else 0.0)


def _above(axes: Axes) -> float:
    return _PAD + _label(axes.title)


def _ticks(axis: Axis, shown: str, *, across: bool) -> float:
    """Room that the ticks of an axis take with their labels, along or across the letters."""
    if not axis.get_tick_params().get(shown, True):
        return 0.0
    told, size = _told(axis), _size(axis)
    return _TICK + (_width(told, size) if across else _LINE * size) if told else 0.0


def _told(axis: Axis) -> list[str]:
    """Labels of the ticks in view."""
    low, high = sorted(axis.get_view_interval())
    found = []
    for ticks, places in ((axis.major, axis.get_majorticklocs()), (axis.minor, axis.get_minorticklocs())):
        assert ticks.formatter is not None
        labels = ticks.formatter.format_ticks(list(places))
        found += [text for place, text in zip(places, labels, strict=False) if text and low <= place <= high]
    return found


def _size(axis: Axis) -> float:
    return float(axis.get_tick_params().get("labelsize", _SIZE))


def _width(texts: Sequence[str], size: float) -> float:
    return max((_EM * size * len(line) for text in texts for line in text.split("\n")), default=0.0)


def _label(text: Text) -> float:
    """Room that a label takes across its lines."""
    lines = text.get_text().split("\n") if text.get_text() else []
    return _LINE * float(text.get_fontsize()) * len(lines) + (_PAD if lines else 0.0)


def _below_bars(bars: Sequence[Axes], width: float, height: float) -> float:
    """Place bars of colours at the bottom; return the height that they take."""
    taken = 0.0
    for axes in bars:
        share, times = _BAR
        low = taken + _below(axes)
        tall = share * width / times
        axes.set_position(((1.0 - share) / 2.0, low / height, share, tall / height))
        taken = low + tall + _PAD
    return taken
