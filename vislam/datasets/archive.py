"""Arrays of an ``.npz`` file, read with care: types, shapes and sizes first, nothing unpickled."""

import hashlib
import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from vislam.base.errors import DataError, first_line
from vislam.base.legible import brief
from vislam.base.npy import ArrayError, PackedArray, open_array
from vislam.base.types import Array
from vislam.datasets.checks import LARGEST_NUMBER, Checks

_MOST_SMALL_VALUES = 1 << 22
# RuntimeError and ValueError: an unknown method, an encrypted member, an offset that is none.
_BROKEN = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, RuntimeError, ValueError)


@contextmanager
def opened(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open an ``.npz`` file; whatever is broken about it while it is read becomes a DataError."""
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    except DataError:
        raise
    except _BROKEN as error:
        raise DataError(
            f"{path}: not a whole npz archive ({brief(first_line(error))}); fetch or copy the file again"
        ) from None


def array_names(archive: zipfile.ZipFile) -> set[str]:
    """Keys of the arrays that an archive has."""
    return {name.removesuffix(".npy") for name in archive.namelist() if name.endswith(".npy")}


def sha256(path: Path) -> str:
    """Hash of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class Arrays:
    """Arrays of an open archive.

    Attributes
    ----------
    keys : set of str
    checks : Checks
    """

    def __init__(self, archive: zipfile.ZipFile, path: Path) -> None:
        self._archive, self._path = archive, path
        self.keys = array_names(archive)
        self.checks = Checks(path)

    def one_of(self, *keys: str) -> str:
        """First of the keys that the file has; DataError if it has none."""
        for key in keys:
            if key in self.keys:
                return key
        wanted = " or ".join(f"'{key}'" for key in keys)
        raise DataError(
            f"{self._path}: key {wanted} is missing; the file has {brief(', '.join(sorted(self.keys)))}"
        )

    def open(self, key: str) -> PackedArray:
        """Open an array as a stream."""
        try:
            return open_array(self._archive, f"{key}.npy")
        except ArrayError as error:
            raise DataError(f"{self._path}: '{key}' {error}") from None

    def small(
        self,
        key: str,
        shape: tuple[int, ...] | None = None,
        *,
        largest: float = LARGEST_NUMBER,
        unit: str = "",
        most: int = _MOST_SMALL_VALUES,
    ) -> Array:
        """Read a whole array of finite numbers, float64, of the given shape."""
        packed = self.open(key)
        with packed.stream:
            if shape is not None and packed.shape != shape:
                raise self.checks.fail(key, f"of shape {shape}", f"{packed.shape}")
            if packed.size > most:
                raise self.checks.fail(key, f"of at most {most} numbers", f"shape {packed.shape}")
            flat = np.concatenate([np.empty(0), *packed.chunks()])
        self.checks.numbers(key, flat, largest=largest, unit=unit)
        return flat.reshape(packed.shape, order="F" if packed.fortran else "C")
