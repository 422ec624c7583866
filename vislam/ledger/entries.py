"""Entries of the ledger: what the files of a comparison, a study or an inspection say of it."""

import csv
import json
import os
import statistics
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from math import isfinite
from pathlib import Path
from typing import Any

from vislam.base.errors import first_line
from vislam.base.files import open_regular

ERRORS = ("ate_rmse", "ate_planar_rmse")
"""Errors of which the first that a run has is its headline."""
NEES = ("nees_pose", "nees_position_planar", "nees_position_aligned")
HEADLINES = {"error": ERRORS, "held-out": ("held_out_median",), "NEES": NEES, "time": ("total_time_s",)}
"""Headline figures, each the first metric of its list that a run has."""
_PASSED_OVER = frozenset(("runs", "list", "figures", "trials", "cases", "node_modules", "__pycache__"))
"""Folders of results that hold no results of their own, and those of tools."""
_MOST_BYTES = 1 << 26
"""Largest file that is read; that of ten estimators has less than a hundredth."""
_DATE = "%Y-%m-%d %H:%M UTC"


@dataclass(frozen=True)
class Entry:
    """One comparison, study or inspection.

    Attributes
    ----------
    kind : str
        ``comparison``, ``study`` or ``inspection``.
    folder : Path
    when : datetime
        By its provenance; else when its file was written.
    name, data : str
        Of the config, and of what it was run on.
    page : Path or None
    estimators : tuple of str
    metrics : mapping of str to float
        ``<estimator>.<key>`` or ``<estimator>.<key>.<estimate>``; of a study, medians over its trials.
    checks : (int, int)
        How many hold, of how many.
    told : str
        What is to be said in place of figures.
    provenance : mapping of str to str
    document : mapping
        The file as it is.
    problem : str
        Why the file cannot be used; empty if it can.
    """

    kind: str
    folder: Path
    when: datetime
    name: str = ""
    data: str = ""
    page: Path | None = None
    estimators: tuple[str, ...] = ()
    metrics: Mapping[str, float] = field(default_factory=dict)
    checks: tuple[int, int] = (0, 0)
    told: str = ""
    provenance: Mapping[str, str] = field(default_factory=dict)
    document: Mapping[str, Any] = field(default_factory=dict)
    problem: str = ""

    def metric(self, estimator: str, key: str) -> float | None:
        """Metric of a run: of its smoothed poses, else of its filtered ones, else of it as a whole."""
        of = self.estimate(estimator, key)
        return None if of is None else self.metrics[".".join(filter(None, (estimator, key, of)))]

    def estimate(self, estimator: str, key: str) -> str | None:
        """Of which estimate a metric of a run is: "smoothed", "filtered" or "", of it as a whole."""
        for of in ("smoothed", "filtered", ""):
            if ".".join(filter(None, (estimator, key, of))) in self.metrics:
                return of
        return None

    def headline(self, estimator: str, what: str) -> float | None:
        """One of ``HEADLINES`` of a run."""
        found = (self.metric(estimator, key) for key in HEADLINES[what])
        return next((value for value in found if value is not None), None)

    @property
    def commit(self) -> str:
        """Commit, or else the version of the package."""
        found = self.provenance.get("commit", "")
        head = found.partition(",")[0]
        if len(head) == 40:
            return head[:10] + ("+" if "," in found else "")
        return self.provenance.get("vislam", "")


def find(folder: Path) -> list[Entry]:
    """Every entry below a folder, the newest first; a file that cannot be used is one with its problem."""
    found = [entry for path in _walk(folder) if (entry := _read(path)) is not None]
    return sorted(found, key=lambda entry: (entry.when, str(entry.folder)), reverse=True)


def read(folder: Path) -> Entry | None:
    """The entry of one folder; None if it holds none."""
    for name in _READERS:
        if (folder / name).is_file():
            return _read(folder / name)
    return None


def _walk(folder: Path) -> Iterator[Path]:
    """Files of entries below a folder, those of tools and of parts of results passed over."""
    for here, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if name not in _PASSED_OVER and not name.startswith("."))
        yield from (Path(here) / name for name in sorted(set(files) & _READERS.keys()))


def _read(path: Path) -> Entry | None:
    kind, reader = _READERS[path.name]
    when = datetime.fromtimestamp(path.stat().st_mtime, UTC)
    try:
        with open_regular(path) as file:
            document = json.loads(file.read(_MOST_BYTES))
        # Many a tool has a metrics.json: one of another has nothing to do here.
        if not isinstance(document, dict) or "schema_version" not in document:
            return None
        made = {str(key): str(value) for key, value in dict(document.get("provenance", {})).items()}
        with suppress(ValueError):
            when = datetime.strptime(made.get("date", ""), _DATE).replace(tzinfo=UTC)
        return Entry(
            kind, path.parent, when, provenance=made, document=document, **reader(path.parent, document)
        )
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        return Entry(kind, path.parent, when, problem=first_line(error) or type(error).__name__)


def _comparison(folder: Path, document: Mapping[str, Any]) -> dict[str, Any]:
    checks = document["checks"]
    return {
        "name": str(document["name"]),
        "data": str(document["dataset"]["name"])
        + (" [SIMULATED]" if is_synthetic(document["dataset"]) else ""),
        "page": _page(folder / "report.html"),
        "estimators": tuple(map(str, document["runs"])),
        "metrics": {
            ".".join(filter(None, (item["estimator"], item["key"], item["estimate"]))): float(item["value"])
            for item in document["metrics"]
        },
        "checks": (sum(bool(check["holds"]) for check in checks), len(checks)),
        "told": ", ".join(
            f"{name} INCOMPLETE" for name, run in document["runs"].items() if not run["complete"]
        ),
    }


def _study(folder: Path, document: Mapping[str, Any]) -> dict[str, Any]:
    config, counts = document["config"], document["counts"]
    data = config["data"]
    lost = sum(int(counts[key]) for key in counts if key != "done")
    return {
        "name": str(document["name"]),
        "data": str(data.get("file") or data.get("source") or "simulation"),
        "page": _page(folder / "study.html"),
        "estimators": tuple(map(str, config["estimators"])),
        "metrics": _medians(folder / "trials.csv"),
        "told": f"{document['points']} points, {document['seeds']} seeds"
        + (f", {lost} lost or failed" if lost else ""),
    }


def _medians(path: Path) -> dict[str, float]:
    """Median of each headline metric of each run over the trials of a table."""
    wanted = {key for keys in HEADLINES.values() for key in keys}
    values: dict[str, list[float]] = {}
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            for name, text in row.items():
                if text and wanted.intersection(str(name).split(".")[1:]):
                    values.setdefault(str(name), []).append(float(text))
    return {
        name: statistics.median(known)
        for name, some in values.items()
        if (known := [value for value in some if isfinite(value)])
    }


def _inspection(folder: Path, document: Mapping[str, Any]) -> dict[str, Any]:
    findings = document["findings"]
    faults = [str(item["check"]) for item in findings if item["verdict"] == "fault"]
    sound = sum(item["verdict"] != "fault" for item in findings)
    return {
        "name": "inspection",
        "data": str(document["name"]) + (" [SIMULATED]" if is_synthetic(document) else ""),
        "page": _page(folder / "inspection.html"),
        "checks": (sound, len(findings)),
        "told": f"faults: {', '.join(faults)}" if faults else "no fault",
    }


def is_synthetic(section: Mapping[str, Any]) -> bool:
    """Whether data are those of a simulation; earlier versions wrote ``stand_in``."""
    return bool(section["synthetic"] if "synthetic" in section else section["stand_in"])


def _page(path: Path) -> Path | None:
    return path if path.is_file() else None


_READERS: dict[str, tuple[str, Callable[[Path, Mapping[str, Any]], dict[str, Any]]]] = {
    "metrics.json": ("comparison", _comparison),
    "study.json": ("study", _study),
    "inspection.json": ("inspection", _inspection),
}
"""Kind and reader of each file that makes a folder an entry."""
