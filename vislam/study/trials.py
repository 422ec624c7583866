"""The finished trials of a study as one table, a row each."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vislam.types import Array, BoolArray, IntArray


@dataclass(frozen=True)
class Trials:
    """Finished trials of a study, one row each.

    Attributes
    ----------
    seed : (n,)
    point : mapping of dotted path to tuple
        Value ``(n,)`` of each swept parameter; empty if only the seed differs.
    done : (n,)
        Whether the trial was carried out, be it with runs that failed.
    complete : mapping of estimator to (n,)
        Whether its run finished.
    reason : tuple of str
        Why the trial or its runs failed ``(n,)``; empty if none did.
    values : mapping of (estimator, metric key) to (n,)
        NaN where missing.
    """

    seed: IntArray
    point: Mapping[str, tuple[Any, ...]]
    done: BoolArray
    complete: Mapping[str, BoolArray]
    reason: tuple[str, ...]
    values: Mapping[tuple[str, str], Array]

    def __len__(self) -> int:
        return len(self.seed)

    @classmethod
    def of_records(cls, records: Sequence[Mapping[str, Any]]) -> "Trials":
        """Read plain data of trials: seed, point, status, reason, and what became of the runs.

        A trial that failed may lack ``runs`` and ``metrics``. ValueError if trials differ in what is swept.
        """
        paths = list(records[0]["point"]) if records else []
        for record in records:
            if set(record["point"]) != set(paths):
                raise ValueError(
                    f"expected every trial to name the parameters {paths}, got {list(record['point'])}"
                )
        names = dict.fromkeys(name for record in records for name in record.get("runs", {}))
        return cls(
            seed=np.array([record["seed"] for record in records], dtype=np.int64),
            point={path: tuple(_hashable(record["point"][path]) for record in records) for path in paths},
            done=np.array([record["status"] == "done" for record in records], dtype=bool),
            complete={
                name: np.array([_finished(one, name) for one in records], dtype=bool) for name in names
            },
            reason=tuple(_reason(record) for record in records),
            values=_values(records),
        )

    def value(self, name: str, key: str) -> Array:
        """Metric of an estimator in each trial ``(n,)``, NaN where missing or where its run did not finish.

        A run that broke off may look better than one that saw the hard part.
        """
        found = self.values.get((name, key), np.full(len(self), np.nan))
        return np.where(self.complete[name], found, np.nan)

    def levels(self, path: str) -> list[Any]:
        """Values of a swept parameter, numbers in ascending order, others as they came."""
        found = list(dict.fromkeys(self.point[path]))
        return sorted(found) if all(is_number(value) for value in found) else found

    def at(self, point: Mapping[str, Any]) -> IntArray:
        """Rows of the trials with these values of these parameters."""
        rows = np.ones(len(self), dtype=bool)
        for path, value in point.items():
            rows &= np.array([each == value for each in self.point[path]], dtype=bool)
        return np.flatnonzero(rows)

    def groups(self) -> list[tuple[dict[str, Any], IntArray]]:
        """Points in order, each with the rows of its trials; one if nothing is swept."""
        choices = itertools.product(*(self.levels(path) for path in self.point))
        points = [dict(zip(self.point, values, strict=True)) for values in choices]
        return [(point, rows) for point in points if len(rows := self.at(point))]


def is_number(value: object) -> bool:
    """Whether a value of a parameter has a place on an axis."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def _hashable(value: Any) -> Any:
    return tuple(_hashable(item) for item in value) if isinstance(value, list | tuple) else value


def _finished(record: Mapping[str, Any], name: str) -> bool:
    return bool(record.get("runs", {}).get(name, {}).get("complete", False))


def _reason(record: Mapping[str, Any]) -> str:
    if record["status"] != "done":
        return record["reason"] or "no reason given"
    told = {name: run.get("error") for name, run in record["runs"].items() if not run["complete"]}
    return "; ".join(f"{name}: {error or 'incomplete'}" for name, error in told.items())


def _values(records: Sequence[Mapping[str, Any]]) -> dict[tuple[str, str], Array]:
    values: dict[tuple[str, str], Array] = {}
    for row, record in enumerate(records):
        for metric in record.get("metrics", ()):
            cell = (metric["estimator"], metric["key"])
            column = values.setdefault(cell, np.full(len(records), np.nan))
            column[row] = np.nan if metric["value"] is None else metric["value"]
    return values
