"""How far the errors of runs move with choices that nobody can defend to the last digit."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field, StrictFloat
from pydantic.dataclasses import dataclass as checked

from vislam.base import settings
from vislam.base.errors import ConfigError, DataError, first_line
from vislam.base.files import open_regular
from vislam.base.legible import brief
from vislam.core.run import Estimate
from vislam.evaluation.metric import METRICS

_MOST_BYTES = 1 << 24
_Number = Annotated[StrictFloat, Field(allow_inf_nan=False)]


@checked(frozen=True)
class _Errors:
    estimator: str
    estimate: Estimate
    values: tuple[_Number | None, ...]


@checked(frozen=True)
class _Saved:
    key: str
    points: Annotated[tuple[str, ...], Field(min_length=1)]
    errors: tuple[_Errors, ...]

    def __post_init__(self) -> None:
        """Reject what no comparison writes."""
        if self.key not in METRICS:
            raise ValueError(f"key: expected that of a metric, got {self.key}")
        if any(len(one.values) != len(self.points) for one in self.errors):
            raise ValueError("errors: expected a value for each of the points")


@dataclass(frozen=True)
class Spread:
    """An error of each run at the points of a neighbourhood of the settings, and with other tracks held out.

    Attributes
    ----------
    key : str
        Of the metric.
    points : tuple of str
        What each point changes, ``(n,)``; the first is the comparison itself.
    values : mapping of (run, estimate) to tuple of float or None
        At each point ``(n,)``; None where the run did not finish.
    """

    key: str
    points: tuple[str, ...]
    values: Mapping[tuple[str, Estimate], tuple[float | None, ...]]

    def record(self) -> dict[str, Any]:
        """Plain data for JSON."""
        values = [
            {"estimator": name, "estimate": estimate, "values": list(values)}
            for (name, estimate), values in self.values.items()
        ]
        return {"key": self.key, "points": list(self.points), "errors": values}

    @classmethod
    def read(cls, path: Path) -> "Spread | None":
        """Read what was written; None if there is nothing. A DataError says what is wrong with it."""
        if not path.is_file():
            return None
        try:
            with open_regular(path) as file:
                found = settings.parse(_Saved, json.loads(file.read(_MOST_BYTES)))
        except (OSError, ValueError, RecursionError, ConfigError) as error:
            raise DataError(
                f"{path}: expected the robustness of a comparison as this version writes it "
                f"({brief(first_line(error))}); remove it, or run the comparison with --robustness again"
            ) from None
        values = {(one.estimator, one.estimate): one.values for one in found.errors}
        return cls(found.key, found.points, values)

    def range_of(self, name: str, estimate: Estimate) -> tuple[float, float] | None:
        """Smallest and largest value of a run; None if it has none."""
        known = [value for value in self.values.get((name, estimate), ()) if value is not None]
        return (min(known), max(known)) if known else None

    def difference(self, one: str, other: str, estimate: Estimate) -> tuple[float, float] | None:
        """Smallest and largest difference of two runs at the same point; None if there is none.

        Both move together with the settings: what tells whether one is better is the difference, not its
        parts.
        """
        pairs = zip(
            self.values.get((one, estimate), ()), self.values.get((other, estimate), ()), strict=False
        )
        known = [float(np.subtract(a, b)) for a, b in pairs if a is not None and b is not None]
        return (min(known), max(known)) if known else None
