"""Arrays inside an npz archive, opened as streams: type, shape and size are checked before memory is taken.

Nothing is unpickled or evaluated, and what an array claims to be must agree with what the archive says of it.
"""

import math
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, Any

import numpy as np

_MAGIC = b"\x93NUMPY"
_LONGEST_HEADER = 10_000
_MOST_DIMENSIONS = 4
_CHUNK_VALUES = 1 << 20
LARGEST_BYTES = 1 << 33
"""Largest array [bytes], unpacked; the largest recording has 1.3e9. A small file can claim far more."""
_DESCR = re.compile(r"""['"]descr['"]\s*:\s*['"]([^'"]*)['"]""")
_ORDER = re.compile(r"""['"]fortran_order['"]\s*:\s*(True|False)""")
_SHAPE = re.compile(r"""['"]shape['"]\s*:\s*\(([^()]*)\)""")
_EXTENT = re.compile(r"\s*(\d{1,18})L?\s*", re.ASCII)
REAL = re.compile(r"[<>|=](f[248]|[iu][1248])")
"""Type of real numbers, as a header states it."""


class ArrayError(Exception):
    """An array that cannot be read; its message has what was expected and what was found."""

    def __init__(self, expected: str, got: str) -> None:
        super().__init__(f"must be {expected}, got {got}")


@dataclass(frozen=True)
class PackedArray:
    """An array behind its header, not yet read.

    Attributes
    ----------
    stream : file
    shape : tuple of int
    fortran : bool
        Whether the first index runs fastest.
    dtype : numpy.dtype
    """

    stream: IO[bytes]
    shape: tuple[int, ...]
    fortran: bool
    dtype: np.dtype[Any]

    @property
    def size(self) -> int:
        """Number of entries."""
        return math.prod(self.shape)

    def chunks(self) -> Iterator[np.ndarray[Any, Any]]:
        """Entries in the order of the file, piece by piece; EOFError if there are too few."""
        left = self.size
        while left:
            wanted = min(left, _CHUNK_VALUES)
            piece = self.stream.read(wanted * self.dtype.itemsize)
            if len(piece) != wanted * self.dtype.itemsize:
                raise EOFError("an array ends early")
            left -= wanted
            yield np.frombuffer(piece, dtype=self.dtype)
        # The check sum is compared when the end is met.
        self.stream.read(1)


def open_array(
    archive: zipfile.ZipFile, name: str, *, stored: re.Pattern[str] = REAL, what: str = "real numbers"
) -> PackedArray:
    """Open a member of an archive; ArrayError if it is no array of such a type and of a size that can be."""
    information = archive.getinfo(name)
    # Other methods unpack a small piece to any size at once; numpy writes none of them.
    if information.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise ArrayError("stored or deflated, as numpy does it", f"method {information.compress_type}")
    stream = archive.open(name)
    try:
        return _opened(stream, information, stored=stored, what=what)
    except BaseException:
        stream.close()
        raise


def _opened(
    stream: IO[bytes], information: zipfile.ZipInfo, *, stored: re.Pattern[str], what: str
) -> PackedArray:
    descr, fortran, shape = _read_header(stream)
    if not stored.fullmatch(descr):
        raise ArrayError(f"a plain array of {what} (pickled objects are rejected)", repr(descr[:40]))
    array = PackedArray(stream, shape, fortran, np.dtype(descr))
    expected, got = array.size * array.dtype.itemsize, information.file_size - stream.tell()
    if expected != got:
        raise ArrayError(f"{expected:.6g} bytes long as its shape {shape} says", f"{got} bytes")
    if expected > LARGEST_BYTES:
        raise ArrayError(f"at most {LARGEST_BYTES:.2g} bytes long", f"{expected:.2g} bytes, shape {shape}")
    return array


def _read_header(stream: IO[bytes]) -> tuple[str, bool, tuple[int, ...]]:
    """Type, order and shape that a header of version 1, 2 or 3 states, by pattern: it is not evaluated."""
    start = stream.read(8)
    if len(start) < 8 or start[:6] != _MAGIC or start[6] not in (1, 2, 3):
        raise ArrayError("a numpy array", f"one that starts with {start!r}")
    length = int.from_bytes(stream.read(2 if start[6] == 1 else 4), "little")
    text = stream.read(min(length, _LONGEST_HEADER)).decode("latin-1")
    descr, order, shape = _DESCR.search(text), _ORDER.search(text), _SHAPE.search(text)
    if order is None or shape is None or length > _LONGEST_HEADER:
        raise ArrayError("a numpy array with a header of its type, order and shape", repr(text[:80]))
    extents = [_EXTENT.fullmatch(extent) for extent in shape[1].removesuffix(",").split(",")]
    numbers = tuple(int(extent[1]) for extent in extents if extent is not None)
    if (len(numbers) != len(extents) and shape[1].strip()) or len(numbers) > _MOST_DIMENSIONS:
        raise ArrayError("a numpy array of a shape that can be", f"({shape[1][:40]})")
    return "" if descr is None else descr[1], order[1] == "True", numbers
