"""Numbers of a text file as editors, shells and loggers leave it: any encoding, any separator, any header."""

import math
import os
import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from vislam.base.errors import DataError, first_line
from vislam.base.files import open_regular
from vislam.base.legible import quoted
from vislam.base.types import Array, IntArray

_LARGEST_BYTES = 1 << 28
_LARGEST_NUMBER = 1e20
"""Stamps in nanoseconds have 19 digits; beyond this, products overflow sooner or later."""
_FEWEST = 2
_MOST_COLUMNS = 256
_LONGEST_LINE = 1 << 15
"""Characters; a file without line ends is no table."""
_COMMENTS = ("#", "%", "//")
_LOST = {"", "-nan(ind)", "nan(ind)", "null", "none", "na", "n/a"}
_BOMS = ((b"\xef\xbb\xbf", "utf-8"), (b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be"))
_UNITS = re.compile(r"\[[^\]]*\]|\([^)]*\)")


@dataclass(frozen=True)
class TextTable:
    """Rows of numbers.

    Attributes
    ----------
    path : Path
    values : (n, c)
        NaN where a number is lost.
    line : (n,)
        Where in the file each row stands, from 1.
    names : tuple of str
        Of the columns, in lower case; empty if no line names them all.
    unit : str
        In brackets behind the name of the first column; empty without.
    comments : tuple of str
        Lines that are comments.
    commas : bool
        Whether commas or semicolons separate the numbers.
    told : tuple of str
        What was out of the ordinary.
    counts : dict
        What was left out.
    first : dict
        What is wrong with the first of each kind in ``counts``, for who rejects it.
    """

    path: Path
    values: Array
    line: IntArray
    names: tuple[str, ...] = ()
    unit: str = ""
    comments: tuple[str, ...] = ()
    commas: bool = False
    told: tuple[str, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)
    first: dict[str, str] = field(default_factory=dict)

    @property
    def columns(self) -> int:
        """Number of columns."""
        return int(self.values.shape[1])

    @property
    def whole_first(self) -> bool:
        """Whether the first column holds whole numbers only."""
        first = self.values[:, 0][np.isfinite(self.values[:, 0])]
        return bool(np.all(first == np.round(first)))


def read_text_table(path: Path, *, wanted: str = "finite numbers") -> TextTable:
    """Read a text file of numbers.

    A byte order mark and UTF-16 are understood, commas, semicolons, tabs and blanks separate, lines that
    begin with ``#``, ``%`` or ``//`` and a line of words before the first numbers are headers. What is no
    number but a word for none (``nan``, ``null``) is NaN. A last line that is cut off is dropped and counted.

    Parameters
    ----------
    path : Path
    wanted : str
        What a line must hold, for messages.

    Raises
    ------
    DataError
        If the file cannot be read, is no text, or a line is no row like the others.
    """
    text, told = _decoded(path, wanted)
    return _plain(path, text, told) or _table(path, text, told, wanted)


def _decoded(path: Path, wanted: str) -> tuple[str, list[str]]:
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            if size > _LARGEST_BYTES:
                raise DataError(f"{path}: must be a text file of at most {_LARGEST_BYTES} bytes, got {size}")
            head = file.read(_LONGEST_LINE)
            if len(head) == _LONGEST_LINE and b"\n" not in head and b"\r" not in head:
                raise DataError(f"{path}:1: must hold {wanted}, got a line without an end")
            content = head + file.read(max(size - len(head), 0))
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({first_line(error)})") from None
    for mark, name in _BOMS:
        if content.startswith(mark):
            return _strict(path, content[len(mark) :], name), [f"byte order mark, {name}"]
    if content[1:2] == b"\0" and content[3:4] == b"\0":
        return _strict(path, content, "utf-16-le"), ["utf-16-le"]
    if b"\0" in content[:4096]:
        raise DataError(
            f"{path}: must be a text file of numbers, got a binary one; name its format, or export it as text"
        )
    return content.decode("utf-8", errors="replace"), []


def _strict(path: Path, content: bytes, encoding: str) -> str:
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        raise DataError(f"{path}: must be {encoding} as it begins, got {error.reason}") from None


def _plain(path: Path, text: str, told: list[str]) -> TextTable | None:
    """Table of a text in which nothing is out of the ordinary, quickly; None where something is."""
    lines = [line.strip() for line in text.splitlines()]
    place = [number for number, line in enumerate(lines, 1) if line and not line.startswith(_COMMENTS)]
    rows = [lines[number - 1] for number in place]
    if len(rows) < _FEWEST or ";" in rows[0] or not text.endswith(("\n", "\r")):
        return None
    commas = "," in rows[0]
    try:
        values = np.loadtxt(rows, delimiter="," if commas else None, comments=None, ndmin=2)
    except ValueError:
        return None
    if len(values) != len(rows) or not (np.abs(values) <= _LARGEST_NUMBER).all():
        return None
    comments = tuple(line.lstrip("#%/ ") for line in lines if line.startswith(_COMMENTS))
    names, unit = _names(list(comments), values.shape[1])
    return TextTable(path, values, np.array(place, np.int64), names, unit, comments, commas, tuple(told))


def _table(path: Path, text: str, told: list[str], wanted: str) -> TextTable:
    rows: list[list[float]] = []
    places: list[int] = []
    headers: list[str] = []
    comments: list[str] = []
    commas = False
    first: dict[str, str] = {}
    every = text.splitlines()
    whole = text.endswith(("\n", "\r"))
    for number, raw in enumerate(every, 1):
        line = raw.strip().strip("\ufeff")
        if not line:
            continue
        if line.startswith(_COMMENTS):
            comments.append(line.lstrip("#%/ "))
            headers.append(comments[-1])
            continue
        row = _numbers(line)
        if row is not None:
            commas = commas or "," in line or ";" in line
            rows.append(row)
            places.append(number)
        elif rows or len(headers) > len(comments) or not _is_header(line):
            wrong = next((part for part in _parts(line) if _number(part) is None), line)
            message = f"{path}:{number}: must hold {wanted}, got {quoted(wrong[:20])}"
            if whole or not rows or number < len(every):
                raise DataError(message)
            first["rows_cut_off"] = message
        else:
            headers.append(line)
            told.append(f"header line {quoted(line[:60])}")
    values, short = _rectangular(path, rows, places, whole=whole or bool(first))
    first |= short
    names, unit = _names(headers, values.shape[1])
    return TextTable(
        path,
        values,
        np.array(places[: len(values)], dtype=np.int64),
        names,
        unit,
        tuple(comments),
        commas,
        tuple(told),
        dict.fromkeys(first, 1),
        first,
    )


def _is_header(line: str) -> bool:
    """Whether a line is one of names: no number is among them."""
    return all(_number(part) is None for part in _parts(line))


def _parts(line: str) -> list[str]:
    if "," not in line and ";" not in line:
        return line.split()
    found = [piece for part in re.split(r"[,;]", line) for piece in (part.split() or [""])]
    # Some loggers end each line with a separator.
    while found and not found[-1]:
        found.pop()
    return found


def _number(part: str) -> float | None:
    # Python would take an underscore for a group of digits.
    if "_" in part:
        return None
    try:
        return float(part)
    except ValueError:
        return math.nan if part.lower() in _LOST else None


def _numbers(line: str) -> list[float] | None:
    """Numbers of a line, NaN for those that are lost; None if there is a word in it."""
    row = []
    for part in _parts(line)[:_MOST_COLUMNS]:
        value = _number(part)
        if value is None:
            return None
        row.append(value if math.isfinite(value) else math.nan)
    return row or None


def _rectangular(
    path: Path, rows: list[list[float]], places: list[int], *, whole: bool
) -> tuple[Array, dict[str, str]]:
    """Rows as one array; the last of a file that ends within a line may be short, any other may not."""
    first: dict[str, str] = {}
    if not rows:
        return np.empty((0, 0)), first
    width = Counter(map(len, rows)).most_common(1)[0][0]
    for index, (row, place) in enumerate(zip(rows, places, strict=True)):
        if len(row) == width:
            continue
        message = f"{path}:{place}: must hold {width} finite numbers, got {len(row)} columns"
        if whole or index < len(rows) - 1 or len(row) > width:
            raise DataError(message)
        first["rows_cut_off"] = message
    values = np.array(rows[: len(rows) - len(first)])
    beyond = np.argwhere(np.abs(values) > _LARGEST_NUMBER)
    if len(beyond):
        row_of, column = beyond[0]
        got = values[row_of, column]
        raise DataError(f"{path}:{places[row_of]}: must hold {width} finite numbers, got {got:g}")
    return values, first


def _names(headers: list[str], columns: int) -> tuple[tuple[str, ...], str]:
    """Names of the columns and the unit of the first, from the last header that has one for each."""
    for line in reversed(headers):
        by_commas = [part.strip() for part in re.split(r"[,;]", line)]
        parts = by_commas if len(by_commas) > 1 else _UNITS.sub(" ", line).split()
        if len(parts) == columns:
            unit = re.search(r"[\[(](s|ms|us|ns)[\])]", line.split(",")[0])
            names = tuple(_UNITS.sub("", part).strip().lower() for part in parts)
            return names, unit[1] if unit else ""
    return (), ""
