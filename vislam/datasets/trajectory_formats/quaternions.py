"""Formats of a stamp, a position and a quaternion a line, with a covariance behind them or without."""

import re
from dataclasses import replace

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.datasets.trajectory_formats import clean
from vislam.datasets.trajectory_formats.options import ReadOptions
from vislam.datasets.trajectory_formats.rows import Rows
from vislam.datasets.trajectory_formats.stamps import seconds
from vislam.datasets.trajectory_formats.table import TextTable
from vislam.geometry.pose_covariance import CovarianceConvention

_POSE = 8
_UPPER_THREE = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_LOWER_SIX = tuple((row, column) for row in range(6) for column in range(row + 1))
_NO_SECONDS = 1e4
"""Median step that is none of seconds: what EuRoC's files have are nanoseconds, whatever they count from."""
_OPENVINS = CovarianceConvention("rotation_first", "split")
_ROS = CovarianceConvention("position_first", "world")


def tum(table: TextTable, options: ReadOptions) -> Rows:
    """TUM: stamp x y z qx qy qz qw; a column of ids before them, as rpg has it, is passed over."""
    values, names = table.values, table.names
    if table.columns == _POSE + 1:
        values, names = values[:, 1:], names[1:]
    return _poses(table, values, names, "tum", options, default="xyzw")


def euroc(table: TextTable, options: ReadOptions) -> Rows:
    """EuRoC, VINS-Fusion: stamp [ns], x, y, z, qw, qx, qy, qz, then anything."""
    if not table.unit and np.median(np.abs(np.diff(table.values[:, 0], prepend=0.0))) > _NO_SECONDS:
        table = replace(table, unit="ns")
    return _poses(table, table.values, table.names, "euroc", options, default="wxyz")


def openvins(table: TextTable, options: ReadOptions) -> Rows:
    """OpenVINS' recorder: a TUM line, then upper triangles of the covariances of rotation and position."""
    cov = np.zeros((len(table.values), 6, 6))
    for block in (0, 3):
        for k, (row, column) in enumerate(_UPPER_THREE):
            value = table.values[:, _POSE + 2 * block + k]
            cov[:, block + row, block + column] = cov[:, block + column, block + row] = value
    told = "covariances of rotation and position as OpenVINS has them, nothing between them in the file"
    return _with_cov(table, cov, options, name="openvins", convention=_OPENVINS, told=told)


def smfeval(table: TextTable, options: ReadOptions) -> Rows:
    """Smfeval's wide TUM and SQUARE: a TUM line, then the lower triangle of the 6x6 covariance, by rows."""
    cov = lower_triangle(table.values[:, _POSE:])
    return _with_cov(table, cov, options, name="smfeval", convention=square_convention(table))


def tum_cov(table: TextTable, options: ReadOptions) -> Rows:
    """A TUM line, then the 36 numbers of the covariance, by rows, as ROS messages have them."""
    cov = table.values[:, _POSE:].reshape(-1, 6, 6)
    told = "covariances in the convention of ROS messages"
    return _with_cov(table, cov, options, name="tum_cov", convention=_ROS, told=told)


def lower_triangle(values: Array) -> Array:
    """Symmetric matrices ``(n, 6, 6)`` of 21 numbers a row."""
    cov = np.empty((len(values), 6, 6))
    for k, (row, column) in enumerate(_LOWER_SIX):
        cov[:, row, column] = cov[:, column, row] = values[:, k]
    return cov


def square_convention(table: TextTable) -> CovarianceConvention:
    """Convention that lines such as ``#%TANGENT_ORDER rotation_translation`` name, or that which is usual."""
    said = dict(line.split(maxsplit=1) for line in table.comments if len(line.split()) > 1)
    first = said.get("TANGENT_ORDER", "translation_rotation").strip() == "rotation_translation"
    left = said.get("TANGENT_CONVENTION", "right_perturbation").strip() == "left_perturbation"
    return CovarianceConvention("rotation_first" if first else "position_first", "left" if left else "right")


def sidecar(table: TextTable) -> tuple[Array, Array, CovarianceConvention | None]:
    """Stamps ``(n,)``, covariances ``(n, 6, 6)`` and their convention of a file beside a TUM one.

    A stamp, then 21 numbers (lower triangle by rows, as smfeval has it) or 36.
    """
    numbers = table.columns - 1
    if numbers not in (21, 36):
        raise DataError(
            f"{table.path}: must hold a stamp and 21 (lower triangle) or 36 numbers of a covariance a line, "
            f"got {table.columns} columns"
        )
    stamp, values = table.values[:, 0], table.values[:, 1:]
    if numbers == 21:
        return stamp, lower_triangle(values), square_convention(table)
    return stamp, values.reshape(-1, 6, 6), None


def _with_cov(
    table: TextTable,
    cov: Array,
    options: ReadOptions,
    *,
    name: str,
    convention: CovarianceConvention,
    told: str = "",
) -> Rows:
    bare = replace(table, values=table.values[:, :_POSE], names=table.names[:_POSE])
    rows = _poses(bare, bare.values, bare.names, name, options, default="xyzw")
    kept = np.isin(table.line, rows.line)
    said = (*rows.told, told) if told else rows.told
    return replace(rows, cov=cov[kept], convention=convention, told=said)


def _poses(
    table: TextTable, values: Array, names: tuple[str, ...], name: str, options: ReadOptions, *, default: str
) -> Rows:
    place, told = _columns(names, default, options)
    stamp, said = seconds(values[:, 0], options.unit, named=table.unit)
    position = values[:, [place["x"], place["y"], place["z"]]]
    quaternion = values[:, [place["qx"], place["qy"], place["qz"], place["qw"]]]
    rows = Rows(
        table.path,
        name,
        table.line,
        position,
        stamp=stamp,
        told=(*table.told, *told, *said),
        counts=dict(table.counts),
        first=dict(table.first),
    )
    return clean.with_quaternions(rows, quaternion)


def _columns(
    names: tuple[str, ...], default: str, options: ReadOptions
) -> tuple[dict[str, int], tuple[str, ...]]:
    """Column of each number, by the order that was given, by the names of the columns, or as usual."""
    order = default if options.quaternion == "auto" else options.quaternion
    usual = {"x": 1, "y": 2, "z": 3} | {f"q{letter}": 4 + k for k, letter in enumerate(order)}
    found: dict[str, int] = {}
    for column, text in enumerate(names):
        if match := re.fullmatch(
            r"(?:.*[._])?(?:q|quat|quaternion|orientation)(?:_\w+?)?[._]?([wxyz])", text
        ):
            found[f"q{match[1]}"] = column
    if options.quaternion != "auto" or sorted(found) != ["qw", "qx", "qy", "qz"]:
        return usual, ()
    named = {**usual, **found}
    if len(set(named.values())) < len(named):
        return usual, ()
    by_name = "".join(key[1] for key in sorted(found, key=found.__getitem__))
    told = () if by_name == default else (f"quaternions {by_name}, as the header says",)
    return named, told
