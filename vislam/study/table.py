"""The table of a study's trials, a row each: as CSV and, where pyarrow is installed, as Parquet."""

import csv
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

from vislam.base.files import replace_whole
from vislam.comparison import config as configuration
from vislam.study.trials import is_number

_ROW_GROUP = 1000
"""Rows that are held until they are written."""


class Table(Protocol):
    """What takes rows one after the other."""

    def write(self, row: Mapping[str, Any]) -> None:
        """Write a row; what it lacks is empty."""
        ...


@contextmanager
def csv_table(path: Path, columns: Sequence[str]) -> Iterator[Table]:
    """Write a CSV file, whole or not at all, a row at a time."""
    with replace_whole(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        yield _Csv(writer, columns)


@contextmanager
def parquet_table(path: Path, columns: Mapping[str, str]) -> Iterator[Table]:
    """Write a Parquet file, whole or not at all, a thousand rows at a time.

    Parameters
    ----------
    path : Path
    columns : mapping of str to str
        Types by name: ``string``, ``int64``, ``double`` or ``bool``.
    """
    # Heavy, and there for those only who have installed it.
    import pyarrow  # noqa: PLC0415
    from pyarrow import parquet  # noqa: PLC0415

    schema = pyarrow.schema([(name, pyarrow.type_for_alias(kind)) for name, kind in columns.items()])
    with replace_whole(path) as temporary, parquet.ParquetWriter(temporary, schema) as writer:
        table = _Parquet(writer, schema, pyarrow.Table)
        yield table
        table.flush()


def has_parquet() -> bool:
    """Whether Parquet can be written."""
    return find_spec("pyarrow") is not None


def kind_of(values: Sequence[Any]) -> str:
    """Type of the column of a swept parameter with these values."""
    if all(isinstance(value, bool) for value in values):
        return "bool"
    if not all(map(is_number, values)):
        return "string"
    return "int64" if all(isinstance(value, int) for value in values) else "double"


def as_text(value: Any) -> Any:
    """Value of a swept parameter as it stands in a cell: sections and lists as in a config."""
    return configuration.inline(value) if isinstance(value, dict | list | tuple) else value


class _Csv:
    def __init__(self, writer: Any, columns: Sequence[str]) -> None:
        self._writer, self._columns = writer, columns

    def write(self, row: Mapping[str, Any]) -> None:
        self._writer.writerow(row.get(name, "") for name in self._columns)


class _Parquet:
    def __init__(self, writer: Any, schema: Any, table: Any) -> None:
        self._writer, self._schema, self._table = writer, schema, table
        self._rows: list[Mapping[str, Any]] = []

    def write(self, row: Mapping[str, Any]) -> None:
        self._rows.append(row)
        if len(self._rows) == _ROW_GROUP:
            self.flush()

    def flush(self) -> None:
        """Write what is held."""
        if self._rows:
            self._writer.write_table(self._table.from_pylist(self._rows, schema=self._schema))
            self._rows = []
