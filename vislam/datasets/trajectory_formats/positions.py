"""Formats of positions without attitudes."""

from dataclasses import replace

import numpy as np

from vislam.base.errors import DataError
from vislam.datasets.trajectory_formats import clean
from vislam.datasets.trajectory_formats.options import ReadOptions
from vislam.datasets.trajectory_formats.rows import Rows
from vislam.datasets.trajectory_formats.stamps import seconds
from vislam.datasets.trajectory_formats.table import TextTable
from vislam.geometry.pose_covariance import CovarianceConvention

_UPPER_THREE = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_IN_THE_WORLD = CovarianceConvention("rotation_first", "world")


def planar_xy(table: TextTable, options: ReadOptions) -> Rows:
    """Lines of frame, x, y."""
    number = table.values[:, 0]
    broken = np.flatnonzero(np.isfinite(number) & (number != np.round(number)))
    if len(broken):
        raise DataError(
            f"{table.path}:{table.line[broken[0]]}: must have a whole number for its frame, "
            f"got {number[broken[0]]:g}"
        )
    lost = np.asarray(~np.isfinite(table.values).all(axis=1), np.bool_)
    frame = np.where(lost, 0.0, number).astype(np.int64)
    position = np.where(lost[:, None], np.nan, table.values[:, 1:3])
    rows = Rows(
        table.path,
        "planar_xy",
        table.line,
        position,
        frame=frame,
        told=table.told,
        counts=dict(table.counts),
        first=dict(table.first),
    )
    return clean.without_lost(rows)


def positions(table: TextTable, options: ReadOptions) -> Rows:
    """Lines of stamp, x, y, z; then nothing, or the covariance of the position (6 numbers or 9), as [m^2]."""
    stamp, told = seconds(table.values[:, 0], options.unit, named=table.unit)
    rows = Rows(
        table.path,
        "positions",
        table.line,
        table.values[:, 1:4],
        stamp=stamp,
        told=(*table.told, *told),
        counts=dict(table.counts),
        first=dict(table.first),
    )
    if (numbers := table.columns - 4) in (6, 9):
        cov = np.full((len(rows), 6, 6), np.nan)
        if numbers == 9:
            cov[:, 3:, 3:] = table.values[:, 4:].reshape(-1, 3, 3)
        else:
            for k, (row, column) in enumerate(_UPPER_THREE):
                cov[:, 3 + row, 3 + column] = cov[:, 3 + column, 3 + row] = table.values[:, 4 + k]
        rows = replace(rows, cov=cov, convention=_IN_THE_WORLD)
    return clean.without_lost(rows)
