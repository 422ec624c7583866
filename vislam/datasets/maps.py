"""Points of maps: PLY files, plain or binary, and npz."""

from pathlib import Path

import numpy as np

from vislam.base.errors import DataError, first_line
from vislam.base.files import open_regular
from vislam.base.types import Array
from vislam.datasets.trajectory_formats.archive import read_arrays

_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
_ORDER = {"binary_little_endian": "<", "binary_big_endian": ">"}
_MOST_BYTES = 1 << 31
_MOST_HEADER = 1 << 16


def read_points(path: Path) -> Array:
    """Points ``(n, 3)`` [m] of a PLY file or an npz file; those that are lost are left out.

    Raises
    ------
    DataError
        If it is neither, or holds no points.
    """
    try:
        with open_regular(path) as file:
            content = file.read(_MOST_BYTES)
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({first_line(error)})") from None
    if content.startswith(b"PK\x03\x04"):
        points = read_arrays(path, ("points_world",))["points_world"]
        if points.ndim != 2 or points.shape[1] != 3:
            raise DataError(f"{path}: must hold points_world (n, 3), got {points.shape}")
    elif content.startswith(b"ply"):
        points = _ply(path, content)
    else:
        raise DataError(f"{path}: must be a map (PLY, or npz with points_world), got neither")
    points = points[np.isfinite(points).all(axis=1)]
    if not len(points):
        raise DataError(f"{path}: must hold points, got none")
    return points


def _ply(path: Path, content: bytes) -> Array:
    """Points of the vertices, which must be the first element: everything behind them is passed over."""
    end = content.find(b"end_header", 0, _MOST_HEADER)
    start = content.find(b"\n", end) + 1
    if end < 0 or start == 0:
        raise DataError(f"{path}: must have the header of a PLY file, got no end of it")
    lines = content[:end].decode("ascii", errors="replace").split("\n")
    words = [line.split() for line in lines if line.split()]
    form = next((line[1] for line in words if line[0] == "format" and len(line) > 1), "")
    elements = [index for index, line in enumerate(words) if line[0] == "element"]
    if not elements or words[elements[0]][1:2] != ["vertex"] or len(words[elements[0]]) < 3:
        raise DataError(f"{path}: must have vertices as the first element of the PLY file")
    try:
        count = int(words[elements[0]][2])
        stop = elements[1] if len(elements) > 1 else len(words)
        fields = [
            (line[2], _TYPES[line[1]]) for line in words[elements[0] + 1 : stop] if line[0] == "property"
        ]
        column = [[name for name, _ in fields].index(axis) for axis in "xyz"]
        if form == "ascii":
            rows = content[start:].split(b"\n", count)[:count]
            values = np.array([line.split()[: len(fields)] for line in rows], float)
            return values.reshape(count, len(fields))[:, column]
        kind = np.dtype([(name, _ORDER[form] + one) for name, one in fields])
        vertices = np.frombuffer(content, kind, count, start)
    except (KeyError, ValueError, IndexError) as error:
        raise DataError(f"{path}: not a PLY file of points with x, y, z ({first_line(error)})") from None
    return np.column_stack([vertices[axis].astype(float) for axis in "xyz"])
