"""Formats of the upper three, or all four, rows of a matrix a line."""

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array, IntArray
from vislam.datasets.trajectory_formats import clean
from vislam.datasets.trajectory_formats.options import ReadOptions
from vislam.datasets.trajectory_formats.rows import Rows
from vislam.datasets.trajectory_formats.stamps import seconds
from vislam.datasets.trajectory_formats.table import TextTable

_LAST_ROW = (0.0, 0.0, 0.0, 1.0)


def kitti(table: TextTable, options: ReadOptions) -> Rows:
    """KITTI odometry: 12 numbers a line (3 x 4, by rows), or 16; the frame is the place in the file."""
    matrix = _upper(table, table.values)
    return _rows(table, "kitti", matrix, frame=np.arange(len(matrix)), by_place=True)


def kitti360(table: TextTable, options: ReadOptions) -> Rows:
    """KITTI-360: the frame, then 12 numbers (``poses.txt``) or 16 (``cam0_to_world.txt``)."""
    number = table.values[:, 0]
    broken = np.flatnonzero(number != np.round(number))
    if len(broken):
        raise DataError(
            f"{table.path}:{table.line[broken[0]]}: must have a whole number for its frame, "
            f"got {number[broken[0]]:g}"
        )
    return _rows(table, "kitti360", _upper(table, table.values[:, 1:]), frame=number)


def stamped_matrices(table: TextTable, options: ReadOptions) -> Rows:
    """A stamp, then 12 numbers or 16."""
    stamp, told = seconds(table.values[:, 0], options.unit, named=table.unit)
    return _rows(table, "matrices", _upper(table, table.values[:, 1:]), stamp=stamp, told=told)


def _upper(table: TextTable, numbers: Array) -> Array:
    if numbers.shape[1] == 16:
        wrong = np.flatnonzero((np.abs(numbers[:, 12:] - _LAST_ROW) > 1e-6).any(axis=1))
        if len(wrong):
            raise DataError(
                f"{table.path}:{table.line[wrong[0]]}: must end in 0 0 0 1, the last row of a pose, "
                f"got {numbers[wrong[0], 12:].tolist()}"
            )
        numbers = numbers[:, :12]
    return numbers.reshape(-1, 3, 4)


def _rows(
    table: TextTable,
    name: str,
    matrix: Array,
    *,
    frame: Array | IntArray | None = None,
    stamp: Array | None = None,
    by_place: bool = False,
    told: tuple[str, ...] = (),
) -> Rows:
    rows = Rows(
        table.path,
        name,
        table.line,
        matrix[:, :, 3],
        stamp=stamp,
        frame=None if frame is None else frame.astype(np.int64),
        by_place=by_place,
        told=(*table.told, *told),
        counts=dict(table.counts),
        first=dict(table.first),
    )
    return clean.with_matrices(rows, matrix)
