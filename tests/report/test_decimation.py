"""Points that are drawn in place of many: as few however many there are, each peak, as near as said."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from vislam.report.canvas import area, band, marks
from vislam.report.decimation import at_most, evenly, extremes, one_a_cell, simplified
from vislam.report.svg import SIMPLIFIED, plain_svg


def wave(count, rng):
    x = np.linspace(0.0, 1000.0, count)
    return x, np.sin(0.05 * x) + 0.1 * rng.normal(size=count)


def test_as_many_rows_as_are_wanted_are_spread_evenly_with_both_ends():
    rows = evenly(100_000, 400)
    assert (len(rows), rows[0], rows[-1]) == (400, 0, 99_999)
    assert np.ptp(np.diff(rows)) <= 1
    assert evenly(5, 400).tolist() == list(range(5))
    assert len(evenly(0, 400)) == 0


def test_a_line_by_its_extremes_has_as_many_points_however_long_and_all_peaks(rng):
    sizes = []
    for count in (10_000, 100_000):
        x, y = wave(count, rng)
        peaks = rng.choice(count, 20, replace=False)
        y[peaks[:10]], y[peaks[10:]] = 9.0, -9.0
        rows = extremes(x, y, 100)
        sizes.append(len(rows))
        column = np.minimum((x / 10.0).astype(int), 99)
        for each in range(100):
            drawn, there = y[rows[column[rows] == each]], y[column == each]
            assert (drawn.min(), drawn.max()) == (there.min(), there.max())
            assert (drawn[0], drawn[-1]) == (there[0], there[-1])
    assert max(sizes) <= 400
    assert sizes[1] < 1.05 * sizes[0]


def test_a_short_line_is_drawn_whole_and_one_at_a_single_time_as_well():
    assert extremes(np.arange(40.0), np.zeros(40), 10).tolist() == list(range(40))
    assert extremes(np.zeros(100), np.arange(100.0), 10).tolist() == [0, 99]


def test_a_path_is_within_what_is_said_of_all_its_points(rng):
    turn = np.cumsum(rng.normal(0.0, 0.01, 20_000))
    path = np.cumsum(np.column_stack([np.cos(turn), np.sin(turn), 0.01 * turn]), axis=0)
    for most, tolerance in ((2000, 1.0), (50, 1.0)):
        rows, off = simplified(path, most, tolerance)
        assert len(rows) <= most
        assert (rows[0], rows[-1]) == (0, len(path) - 1)
        assert off <= tolerance or len(rows) == most
        piece = np.clip(np.searchsorted(rows, np.arange(len(path)), side="right") - 1, 0, len(rows) - 2)
        first, last = path[rows[piece]], path[rows[piece + 1]]
        along, offset = last - first, path - first
        share = np.clip(np.sum(offset * along, axis=1) / np.sum(along**2, axis=1), 0.0, 1.0)
        distance = np.linalg.norm(offset - share[:, None] * along, axis=1).max()
        assert distance == pytest.approx(off)


def test_a_path_that_is_short_or_stands_still_is_kept_or_left_with_its_ends():
    path = np.column_stack([np.arange(10.0), np.zeros(10)])
    assert simplified(path, 10, 1.0)[0].tolist() == list(range(10))
    rows, off = simplified(np.zeros((100, 3)), 10, 1.0)
    assert (rows.tolist(), off) == ([0, 99], 0.0)


def test_of_points_on_each_other_the_one_with_the_largest_rank_is_kept():
    points = np.array([[0.1, 0.1], [0.2, 0.2], [5.0, 5.0], [0.3, 0.1]])
    assert one_a_cell(points, 1.0).tolist() == [0, 2]
    assert one_a_cell(points, 1.0, rank=np.array([1.0, 3.0, 0.0, 2.0])).tolist() == [1, 2]


def test_every_point_has_a_mark_near_it_and_the_marks_are_few(rng):
    points = rng.uniform(0.0, 100.0, (20_000, 2))
    rows = at_most(points, 500, 0.1)
    assert 0 < len(rows) <= 500
    apart = np.linalg.norm(points[:2000, None] - points[rows], axis=2).min(axis=1)
    # 500 cells of 100 x 100 have sides of 4.5 at least, twice that at most, and a diagonal.
    assert apart.max() <= 2.0 * 4.5 * np.sqrt(2.0)
    assert at_most(points[:400], 500, 0.1).tolist() == list(range(400))


def drawn(count, rng):
    """Letters of a figure of a line, a band, an area and marks of as many points."""
    figure = Figure(figsize=(6.4, 6.0))
    above, below = figure.subplots(2, 1)
    x, y = wave(count, rng)
    y[count // 3] = 7.0
    above.plot(x, y)
    band(above, x, y - 1.0, y + 1.0, color="0.5")
    area(above, x, np.abs(y), color="0.8")
    below.set(xlim=(-1.0, 1.0), ylim=(-1.0, 1.0))
    marks(below, np.column_stack([np.cos(x), np.sin(x)]), color="k")
    return figure, plain_svg(figure)


def test_a_figure_of_ten_times_the_points_is_about_as_large(rng):
    sizes = [len(drawn(count, rng)[1]) for count in (10_000, 100_000)]
    assert sizes[1] < 1.3 * sizes[0] < 1e6


def test_a_single_peak_of_a_long_line_and_of_its_band_and_area_is_drawn(rng):
    figure, text = drawn(100_000, rng)
    above = figure.axes[0]
    heights = [float(part.get_paths()[0].vertices[:, 1].max()) for part in above.collections]
    assert heights == [8.0, 7.0]
    # Of the line, matplotlib simplifies the path while it writes it.
    top = 72.0 / figure.dpi * (figure.bbox.height - above.transData.transform((0.0, 7.0))[1])
    (line,) = (
        part.split('d="')[1].split('"')[0] for part in text.split("<path")[1:] if "stroke: #1f77b4" in part
    )
    lowest = min(float(pair.split()[1]) for pair in line.replace("M", "L").split("L")[1:])
    assert lowest == pytest.approx(top, abs=SIMPLIFIED + 0.1)
