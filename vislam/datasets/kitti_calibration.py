"""Calibration files and numbered images as KITTI has them, raw and odometry."""

from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.datasets.text import read_lines
from vislam.geometry import so3

_ROTATION_TOLERANCE = 1e-3
_SUFFIXES = (".png", ".jpg", ".jpeg")


def numbered(folder: Path, count: int, *, digits: int) -> tuple[Path, ...]:
    """Files of the numbers from 0 on, whatever kind of image they are; one that is missing is named, too."""
    found = (
        {path.stem: path for path in folder.iterdir() if path.suffix in _SUFFIXES} if folder.is_dir() else {}
    )
    some = next(iter(found.values()), None)
    suffix = ".png" if some is None else some.suffix
    names = [f"{number:0{digits}d}" for number in range(count)]
    return tuple(found.get(name, folder / f"{name}{suffix}") for name in names)


def read_calibration(path: Path) -> dict[str, list[float]]:
    """Numbers by name; lines that are no numbers, such as the time of calibration, are passed over."""
    values = {}
    for _, line in read_lines(path):
        name, _, rest = line.decode(errors="replace").partition(":")
        try:
            values[name.strip()] = [float(text) for text in rest.split()]
        except ValueError:
            continue
    return values


def matrix_of(path: Path, values: dict[str, list[float]], key: str, shape: tuple[int, ...]) -> Array:
    """Numbers of a name as an array; DataError if they are not as many, or not finite."""
    found = values.get(key)
    if found is None or len(found) != int(np.prod(shape)) or not np.all(np.isfinite(found)):
        got = "none" if found is None else f"{len(found)}"
        raise DataError(f"{path}: {key} must be {int(np.prod(shape))} finite numbers, got {got}")
    return np.array(found).reshape(shape)


def rotation_of(path: Path, values: dict[str, list[float]], key: str) -> Array:
    """The rotation nearest to the matrix of a file, which has seven digits."""
    matrix = matrix_of(path, values, key, (3, 3))
    off, determinant = so3.defect(matrix)
    if off > _ROTATION_TOLERANCE or determinant < 0.0:
        raise DataError(
            f"{path}: {key} must be a rotation, got R^T R off by {off:.2g}, determinant {determinant:.3g}"
        )
    u, _, vt = np.linalg.svd(matrix)
    return np.asarray(u @ vt)
