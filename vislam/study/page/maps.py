"""Heat maps of an error over two swept parameters."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vislam.base.types import Array
from vislam.report.canvas import SMALL, new_figure
from vislam.study.answers import median
from vislam.study.page.labels import errors, metric_label, parameter_label, plain
from vislam.study.trials import Trials

_COLUMNS = 2
"""Panels side by side."""
_DARK = 0.6
"""Share of the scale under which the colour of a cell is dark and its number is written in white."""


def heat_map(trials: Trials) -> Figure | None:
    """Median of the headline error over two swept parameters, a panel for each estimator that has it."""
    if len(trials.point) != 2 or not errors(trials):
        return None
    key = errors(trials)[0]
    cells = {name: _cells(trials, name, key) for name in trials.complete}
    cells = {name: values for name, values in cells.items() if np.isfinite(values).any()}
    known = np.concatenate([values[np.isfinite(values)] for values in cells.values()])
    columns = min(len(cells), _COLUMNS)
    lines = -(-len(cells) // columns)
    figure = new_figure(0.4 + 3.0 * lines)
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    for axes, (name, values) in zip(panels, cells.items(), strict=False):
        image = axes.imshow(values, origin="lower", aspect="auto", vmin=known.min(), vmax=known.max())
        axes.set_title(name, fontsize=SMALL)
        _labelled(axes, trials)
        _numbers(axes, values, low=float(known.min()), high=float(known.max()))
    for axes in panels[len(cells) :]:
        axes.set_axis_off()
    # Its bar stands at the side.
    figure.set_layout_engine("constrained")
    figure.colorbar(image, ax=panels.tolist(), label=f"median {metric_label(key)}")
    return figure


def _cells(trials: Trials, name: str, key: str) -> Array:
    """Median at each point, the first parameter to the right and the second upwards; NaN where none is."""
    across, up = trials.point
    values = np.full((len(trials.levels(up)), len(trials.levels(across))), np.nan)
    for row, second in enumerate(trials.levels(up)):
        for column, first in enumerate(trials.levels(across)):
            found = median(trials, name, key, rows=trials.at({across: first, up: second}))
            if found is not None:
                values[row, column] = found.value
    return values


def _labelled(axes: Axes, trials: Trials) -> None:
    across, up = trials.point
    axes.set_xticks(range(len(trials.levels(across))), [plain(value) for value in trials.levels(across)])
    axes.set_yticks(range(len(trials.levels(up))), [plain(value) for value in trials.levels(up)])
    axes.set(xlabel=parameter_label(across), ylabel=parameter_label(up))


def _numbers(axes: Axes, values: Array, *, low: float, high: float) -> None:
    for (row, column), value in np.ndenumerate(values):
        if np.isfinite(value):
            dark = value < low + _DARK * (high - low)
            told = f"{value:.3g}"
            axes.text(
                column,
                row,
                told,
                ha="center",
                va="center",
                fontsize=SMALL,
                color="white" if dark else "black",
            )
