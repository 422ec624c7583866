"""Which of many points are drawn, so that what is seen, and the size of a page, do not depend on how many."""

import heapq

import numpy as np

from vislam.base.types import Array, IntArray


def evenly(count: int, most: int) -> IntArray:
    """At most ``most`` of ``count`` rows, spread evenly, first and last included."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))


def extremes(x: Array, y: Array | IntArray, columns: int) -> IntArray:
    """Rows of a line over x that look like all of them: of each column the first, least, largest and last.

    Drawn into as many columns the line is the same, and no peak is lost (M4; Jugel, Jerzak, Hackenbroich and
    Markl, *M4: A Visualization-Oriented Time Series Data Aggregation*, VLDB 2014). All rows where there are
    no more than would be kept.

    Parameters
    ----------
    x, y : (n,)
        Finite; x does not decrease.
    columns : int
        Columns that x is parted into.
    """
    if len(x) <= 4 * columns:
        return np.arange(len(x))
    span = float(x[-1] - x[0]) or 1.0
    column = np.minimum(((x - x[0]) / span * columns).astype(np.int64), columns - 1)
    first = np.flatnonzero(np.diff(column, prepend=-1))
    last = np.append(first[1:], len(x)) - 1
    size = last - first + 1
    kept = [first, last]
    for extreme in (np.minimum, np.maximum):
        rows = np.flatnonzero(y == np.repeat(extreme.reduceat(y, first), size))
        kept.append(rows[np.unique(column[rows], return_index=True)[1]])
    return np.unique(np.concatenate(kept))


def one_a_cell(points: Array, cell: float, *, rank: Array | None = None) -> IntArray:
    """Rows, in order, of one point of each cell of a grid that has any.

    Parameters
    ----------
    points : (n, d)
        Finite.
    cell : float
        Side of a cell.
    rank : (n,), optional
        The point with the largest one stands for its cell; by default the first one.
    """
    place = np.floor((points - points.min(axis=0)) / cell).astype(np.int64)
    sides = place.max(axis=0) + 1
    index = np.ravel_multi_index(tuple(place.T), tuple(sides.tolist()))
    order = np.arange(len(points)) if rank is None else np.argsort(-rank, kind="stable")
    return np.sort(order[np.unique(index[order], return_index=True)[1]])


def at_most(points: Array, most: int, cell: float) -> IntArray:
    """Rows, in order, of at most ``most`` points, one a cell, whose side doubles until they are so few.

    All rows where there are no more; the parameters are those of :func:`one_a_cell`.
    """
    rows = np.arange(len(points))
    while len(rows) > most:
        rows = rows[one_a_cell(points[rows], cell)]
        cell *= 2.0
    return rows


def simplified(points: Array, most: int, tolerance: float) -> tuple[IntArray, float]:
    """Rows of at most ``most`` corners of a polyline, and how far a point is from the line of these at most.

    The point that is farthest from the segment over it becomes a corner, until none is farther than the
    tolerance (Ramer, CGIP 1972; Douglas and Peucker, Cartographica 1973), or there are ``most``. All rows,
    and 0, where there are no more to begin with.

    Parameters
    ----------
    points : (n, d)
        Finite.
    most : int
    tolerance : float
        In the unit of the points.
    """
    if len(points) <= most:
        return np.arange(len(points)), 0.0
    rows, left = [0, len(points) - 1], [_farthest(points, 0, len(points) - 1)]
    while len(rows) < most and -left[0][0] > tolerance:
        _, first, row, last = heapq.heappop(left)
        rows.append(row)
        heapq.heappush(left, _farthest(points, first, row))
        heapq.heappush(left, _farthest(points, row, last))
    return np.sort(rows), -left[0][0]


def _farthest(points: Array, first: int, last: int) -> tuple[float, int, int, int]:
    """Minus the distance of the point that is farthest from the segment over it, and ``first, row, last``."""
    offset, along = points[first : last + 1] - points[first], points[last] - points[first]
    share = np.clip(offset @ along / (float(along @ along) or 1.0), 0.0, 1.0)
    squared = np.sum((offset - share[:, None] * along) ** 2, axis=1)
    row = int(squared.argmax())
    return -float(np.sqrt(squared[row])), first, first + row, last
