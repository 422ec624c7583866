"""Tables of numbers in text files, read line by line so that an error can name its line."""

import math
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array, IntArray

_LARGEST_BYTES = 1 << 26
_LONGEST_LINE = 4096
_LARGEST_NUMBER = 1e20
"""Stamps in nanoseconds have 19 digits; beyond this, products overflow sooner or later."""


def read_table(
    path: Path, *, columns: int, more: bool = False, comma: bool = False
) -> tuple[Array, IntArray]:
    """Read lines of finite numbers; empty lines and lines that start with ``#`` are passed over.

    Parameters
    ----------
    path : Path
    columns : int
        Numbers a line.
    more : bool
        Whether further columns may follow, which are ignored and need not be numbers.
    comma : bool
        Whether commas separate the numbers; white space otherwise.

    Returns
    -------
    table : (n, columns)
    line : (n,)
        Where in the file each row stands, from 1.

    Raises
    ------
    DataError
        If the file cannot be read, is not such a table, or is larger than a table of this kind can be.
    """
    values, numbers = array("d"), array("q")
    for number, text in read_lines(path):
        fields = text.split(b"," if comma else None)
        values.extend(_row(fields, columns, more=more, where=f"{path}:{number}"))
        numbers.append(number)
    return np.array(values).reshape(-1, columns), np.array(numbers, dtype=np.int64)


def read_lines(path: Path) -> Iterator[tuple[int, bytes]]:
    """Lines of a text file with their numbers, stripped; empty ones and comments (``#``) are passed over.

    They are bytes and read up to a limit: a binary file has no encoding, and no line ends either.
    """
    try:
        if (size := path.stat().st_size) > _LARGEST_BYTES:
            raise DataError(f"{path}: must be a text file of at most {_LARGEST_BYTES} bytes, got {size}")
        with path.open("rb") as file:
            for number, text in enumerate(iter(lambda: file.readline(_LONGEST_LINE), b""), 1):
                stripped = text.strip()
                if stripped and not stripped.startswith(b"#"):
                    yield number, stripped
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror or error})") from None


def _row(fields: list[bytes], columns: int, *, more: bool, where: str) -> list[float]:
    wanted = f"{columns} finite numbers" + (" or more" if more else "")
    if len(fields) < columns or (len(fields) > columns and not more):
        raise DataError(f"{where}: must hold {wanted}, got {len(fields)} columns")
    row = []
    for text in fields[:columns]:
        try:
            row.append(float(text))
        except ValueError:
            raise DataError(
                f"{where}: must hold {wanted}, got {text[:20].decode(errors='replace')!r}"
            ) from None
        if not math.isfinite(row[-1]) or abs(row[-1]) > _LARGEST_NUMBER:
            raise DataError(f"{where}: must hold {wanted}, got {row[-1]}")
    return row
