"""Looking numbers up by run, key and estimate, the same way wherever they come from."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

from vislam.core.run import Estimate

Value = TypeVar("Value")
Entry = tuple[str, str, Estimate | None]
"""Run, or ``a|b`` for two, key, and estimate; None: of the run as a whole, as its innovations are."""


@dataclass(frozen=True)
class Lookup(Generic[Value]):
    """Numbers by run, key and estimate.

    Attributes
    ----------
    entries : mapping of Entry to Value
    """

    entries: Mapping[Entry, Value]

    def find(self, run: str, key: str, estimate: Estimate | None = None) -> Value | None:
        """Number of an estimate, by default of the final one, or of the run as a whole; None if missing.

        The default never depends on the key: two numbers of a run are of the same estimate.
        """
        chosen = self.final(run) if estimate is None else estimate
        return self.entries.get((run, key, chosen), self.entries.get((run, key, None)))

    def final(self, run: str) -> Estimate:
        """Final estimate of a run, or the last that two share: smoothed if there is such, else filtered."""
        return "smoothed" if run in self._smoothed else "filtered"

    @cached_property
    def _smoothed(self) -> frozenset[str]:
        return frozenset(run for run, _, estimate in self.entries if estimate == "smoothed")
