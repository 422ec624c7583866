"""The layout of figures: no label is cut off, and no panel lies over another."""

import itertools

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from vislam.report import canvas, consistency_figures, top_view
from vislam.report.svg import settle


def long_labels():
    """A figure of rows whose labels on the left are of several lengths."""
    figure, rows = canvas.panels(3, 5.0)
    for axes, scale in zip(rows, (1e-3, 1.0, 1e5), strict=True):
        axes.plot([0.0, 1.0], [-scale, scale], label=f"a name for {scale:g}")
        axes.set_ylabel("a label\nof two lines [m]")
    rows[-1].set_xlabel(canvas.TIME)
    canvas.legend(figure, *rows, columns=1)
    return figure


def bars():
    """A figure of bars with words on the left, a logarithmic axis and a title at the right."""
    figure = canvas.new_figure(3.0)
    axes = figure.subplots()
    axes.barh([0, 1], [0.02, 300.0])
    axes.set_yticks([0, 1], ["isam2: a smoother in place of the filter", "ekf"], fontsize=canvas.SMALL)
    axes.set_xlabel("error [m]")
    canvas.logarithmic(axes, "x")
    figure.suptitle("a name", x=0.99, ha="right", fontsize=canvas.SMALL)
    return figure


def boxes(figure):
    """Extents [px] of all axes with their labels, and of the legends, as they are drawn; the figure's own."""
    settle(figure)
    renderer = FigureCanvasAgg(figure).get_renderer()
    drawn = [axes.get_tightbbox(renderer) for axes in figure.axes if axes.axison]
    return [*drawn, *(legend.get_window_extent(renderer) for legend in figure.legends)], figure.bbox


@pytest.mark.parametrize("which", ["rows", "bars", "top_view", "coverage"])
def test_nothing_is_cut_off_and_nothing_overlaps(which, tiny):
    drawn = {
        "rows": long_labels,
        "bars": bars,
        "top_view": lambda: top_view.top_view(tiny.shown),
        "coverage": lambda: consistency_figures.coverage(tiny.shown),
    }
    found, page = boxes(drawn[which]())
    for box in found:
        assert box.x0 >= -1.0
        assert box.y0 >= -1.0
        assert box.x1 <= page.x1 + 1.0
        assert box.y1 <= page.y1 + 1.0
    for one, other in itertools.combinations(found, 2):
        across = min(one.x1, other.x1) - max(one.x0, other.x0)
        along = min(one.y1, other.y1) - max(one.y0, other.y0)
        assert min(across, along) < 3.0


def test_panels_take_what_labels_leave():
    figure = long_labels()
    settle(figure)
    places = np.array([axes.get_position().bounds for axes in figure.axes])
    # One column of rows alike, over most of the width.
    assert np.ptp(places[:, 0]) == np.ptp(places[:, 2]) == pytest.approx(0.0, abs=1e-12)
    assert np.ptp(places[:, 3]) == pytest.approx(0.0, abs=1e-12)
    assert places[0, 2] > 0.75
    assert places[:, 3].sum() > 0.55
