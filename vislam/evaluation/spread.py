"""How far the errors of runs move with choices that nobody can defend to the last digit."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vislam.core.run import Estimate


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
