"""The ledger as rows: short ones for the terminal and the page, whole ones for a file."""

import csv
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from vislam.base.errors import ConfigError
from vislam.base.files import check_writable, replace_whole
from vislam.evaluation.metric import METRICS
from vislam.ledger.entries import ERRORS, HEADLINES, Entry

HEADER = ("when", "kind", "config", "data", "headline", "checks", "commit", "folder")
_FORMATS = (".csv", ".parquet")


def rows(entries: Sequence[Entry], *, below: Path) -> list[list[str]]:
    """A row for each entry, its folder as seen from another."""
    return [
        [
            entry.when.strftime("%Y-%m-%d %H:%M"),
            entry.kind,
            entry.name or "-",
            entry.data or "-",
            headline(entry),
            f"{entry.checks[0]} of {entry.checks[1]}" if entry.checks[1] else "-",
            entry.commit or "-",
            relative(entry.folder, below),
        ]
        for entry in entries
    ]


def headline(entry: Entry) -> str:
    """Headline errors of the runs, the smallest first, and what else is to be said."""
    if entry.problem:
        return f"cannot be used: {entry.problem}"
    groups = [_errors(entry, estimate) for estimate in ("smoothed", "filtered", "")]
    return "; ".join(filter(None, (*groups, entry.told)))


def _errors(entry: Entry, estimate: str) -> str:
    """Errors of the runs whose headline is of an estimate, the smallest first: never of two in one row."""
    found = []
    for name in entry.estimators:
        known = [(key, of) for key in ERRORS if (of := entry.estimate(name, key)) is not None][:1]
        found += [(entry.metric(name, key), key, name) for key, of in known if of == estimate]
    told = [
        f"{name} {value:.{METRICS[key].digits}f} {METRICS[key].unit}"
        for value, key, name in sorted(found)
        if value is not None
    ]
    return f"{', '.join(told)}{f' ({estimate})' if estimate else ''}" if told else ""


def relative(path: Path, below: Path) -> str:
    """A path as seen from a folder that it lies in."""
    return str(path.relative_to(below)) if path.is_relative_to(below) else str(path)


def check_export(path: Path) -> None:
    """Raise ConfigError or NotWrittenError if no file could be exported there."""
    if path.suffix not in _FORMATS:
        raise ConfigError(f"--export {path}: expected a name that ends in {' or '.join(_FORMATS)}")
    if path.suffix == ".parquet" and find_spec("pyarrow") is None:
        raise ConfigError(
            "--export: Parquet needs pyarrow, which is not installed: pip install 'vislam[parquet]'"
        )
    check_writable(path)


def export(entries: Sequence[Entry], path: Path) -> None:
    """Write a row for each run of each entry, whole or not at all: CSV or Parquet by the end of the name."""
    table = [row for entry in entries for row in _records(entry)]
    columns = list(dict.fromkeys(key for row in table for key in row))
    with replace_whole(path) as temporary:
        if path.suffix == ".csv":
            with temporary.open("w", encoding="utf-8", newline="") as file:
                writer = csv.DictWriter(file, columns)
                writer.writeheader()
                writer.writerows(table)
            return
        # Heavy, and wanted by few.
        import pyarrow  # noqa: PLC0415
        from pyarrow import parquet  # noqa: PLC0415

        data = {name: [row.get(name) for row in table] for name in columns}
        parquet.write_table(pyarrow.table(data), temporary)


def _records(entry: Entry) -> list[dict[str, object]]:
    """A record for each run; one without a run for an entry that has none."""
    held, checks = entry.checks
    own: dict[str, object] = {
        "when": entry.when.isoformat(),
        "kind": entry.kind,
        "config": entry.name,
        "data": entry.data,
        "folder": str(entry.folder),
        "commit": entry.provenance.get("commit", ""),
        "code": entry.provenance.get("code", ""),
        "checks_held": held,
        "checks": checks,
        "told": entry.told or entry.problem,
    }
    found = []
    for name in entry.estimators or ("",):
        named = {key: entry.metric(name, key) for key in METRICS} if name else dict.fromkeys(METRICS)
        heads = {what: entry.headline(name, what) for what in HEADLINES} if name else dict.fromkeys(HEADLINES)
        found.append({**own, "estimator": name, **heads, **named})
    return found
