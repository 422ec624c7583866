"""The finished trials of a study as one table, a row each."""

import itertools
from array import array
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.run import ESTIMATES, Estimate
from vislam.evaluation.lookup import Entry, Lookup


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
    values : mapping of (estimator, metric key, estimate) to (n,)
        NaN where missing; the estimate is None for a number of the run as a whole.
    keys : collection of str or None
        Metrics that were kept; None: all.
    estimate : "filtered", "smoothed" or None
        The one whose metrics are looked at; None: the final one of each run.
    upright : bool
        Whether roll and pitch are observable, so that errors are what an alignment of heading and position
        leaves.
    """

    seed: IntArray
    point: Mapping[str, tuple[Any, ...]]
    done: BoolArray
    complete: Mapping[str, BoolArray]
    reason: tuple[str, ...]
    values: Mapping[Entry, Array]
    keys: Collection[str] | None = None
    estimate: Estimate | None = None
    upright: bool = False

    def __len__(self) -> int:
        return len(self.seed)

    @property
    def any_complete(self) -> bool:
        """Whether some run of some trial finished."""
        return any(bool(flags.any()) for flags in self.complete.values())

    @classmethod
    def of_records(
        cls, records: Iterable[Mapping[str, Any]], *, keys: Collection[str] | None = None
    ) -> "Trials":
        """Read plain data of trials: seed, point, status, reason, and what became of the runs.

        A record is let go once its row is read, so that many trials take little memory.

        Parameters
        ----------
        records : iterable of mapping
            One that failed may lack ``runs`` and ``metrics``.
        keys : collection of str, optional
            Metrics to keep; None: all.

        Raises
        ------
        ValueError
            If trials differ in what is swept.
        """
        reader = _Reader(keys)
        for record in records:
            reader.read(record)
        return reader.trials()

    @property
    def estimates(self) -> tuple[Estimate, ...]:
        """Estimates that some run has; filtered poses are what every run has."""
        smoothed = any(self._values.final(name) == "smoothed" for name in self.complete)
        return ESTIMATES if smoothed else ESTIMATES[:1]

    def of(self, estimate: Estimate) -> "Trials":
        """The same trials by one estimate, with the runs that have it and no other."""
        own = {
            name: flags
            for name, flags in self.complete.items()
            if estimate == "filtered" or self._values.final(name) == estimate
        }
        return replace(self, complete=own, estimate=estimate)

    def final(self, name: str) -> Estimate:
        """The estimate whose metrics are looked at of a run."""
        return self._values.final(name) if self.estimate is None else self.estimate

    @cached_property
    def _values(self) -> Lookup[Array]:
        return Lookup(self.values)

    def value(self, name: str, key: str) -> Array:
        """Metric of an estimator in each trial ``(n,)``, NaN where missing or where its run did not finish.

        A run that broke off may look better than one that saw the hard part. KeyError if the metric is not
        among those that were kept.
        """
        if self.keys is not None and key not in self.keys:
            raise KeyError(f"{key}: expected one of the metrics that were kept, {sorted(self.keys)}")
        found = self._values.find(name, key, self.estimate)
        found = np.full(len(self), np.nan) if found is None else found
        return np.where(self.complete[name], found, np.nan)

    def has(self, key: str) -> bool:
        """Whether some estimator has a metric in some trial."""
        return any(np.isfinite(self.value(name, key)).any() for name in self.complete)

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


class _Reader:
    """Takes trials one by one into columns of numbers."""

    def __init__(self, keys: Collection[str] | None) -> None:
        self._keys = keys
        self._point: dict[str, list[Any]] | None = None
        self._seed, self._done = array("q"), array("b")
        self._reason: list[str] = []
        self._complete: dict[str, array[int]] = {}
        self._values: dict[Entry, array[float]] = {}

    def read(self, record: Mapping[str, Any]) -> None:
        """Add a row."""
        row, point = len(self._seed), record["point"]
        if self._point is None:
            self._point = {path: [] for path in point}
        if set(point) != set(self._point):
            raise ValueError(
                f"expected every trial to name the parameters {list(self._point)}, got {list(point)}"
            )
        for path, column in self._point.items():
            column.append(hashable(point[path]))
        self._seed.append(record["seed"])
        self._done.append(record["status"] == "done")
        self._reason.append(_reason(record))
        for name, run in record.get("runs", {}).items():
            _put(self._complete.setdefault(name, array("b")), row, run["complete"], missing=False)
        for metric in record.get("metrics", ()):
            if metric["value"] is not None and (self._keys is None or metric["key"] in self._keys):
                cell = (metric["estimator"], metric["key"], metric.get("estimate"))
                _put(self._values.setdefault(cell, array("d")), row, metric["value"], missing=np.nan)

    def trials(self) -> Trials:
        """Table of what has been read."""
        rows = len(self._seed)
        for flags in self._complete.values():
            _fill(flags, rows, missing=False)
        for values in self._values.values():
            _fill(values, rows, missing=np.nan)
        return Trials(
            seed=np.array(self._seed, dtype=np.int64),
            point={path: tuple(column) for path, column in (self._point or {}).items()},
            done=np.array(self._done, dtype=bool),
            complete={name: np.array(flags, dtype=bool) for name, flags in self._complete.items()},
            reason=tuple(self._reason),
            values={cell: np.array(values) for cell, values in self._values.items()},
            keys=self._keys,
        )


def _put(column: "array[Any]", row: int, value: float, *, missing: float) -> None:
    """Set a row of a column that may be shorter than that."""
    _fill(column, row, missing=missing)
    column.append(value)


def _fill(column: "array[Any]", rows: int, *, missing: float) -> None:
    column.extend([missing] * (rows - len(column)))


def is_number(value: object) -> bool:
    """Whether a value of a parameter has a place on an axis."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def hashable(value: Any) -> Any:
    """Value of a parameter as a key: lists as tuples, sections as tuples of their pairs."""
    if isinstance(value, Mapping):
        return tuple((name, hashable(item)) for name, item in value.items())
    return tuple(hashable(item) for item in value) if isinstance(value, list | tuple) else value


def _reason(record: Mapping[str, Any]) -> str:
    if record["status"] != "done":
        return record["reason"] or "no reason given"
    told = {name: run.get("error") for name, run in record["runs"].items() if not run["complete"]}
    return "; ".join(f"{name}: {error or 'incomplete'}" for name, error in told.items())
