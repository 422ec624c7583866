"""Ablation: the cost of defects, corrected one after the other and one at a time."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

CASE = "case"
"""What the points of an ablation are told apart by, in place of a dotted path."""


@dataclass(frozen=True)
class Ablation:
    """Defects in the order in which they are corrected.

    Attributes
    ----------
    defects : tuple of str
    """

    defects: tuple[str, ...]

    def label(self, present: Sequence[str]) -> str:
        """Name of the case in which these defects are present."""
        defects, here = self.defects, set(present)
        if not here:
            return "no defect"
        if len(here) == len(defects):
            return "all defects"
        if len(here) == 1:
            return f"only {next(iter(here))}"
        if len(here) == len(defects) - 1:
            return f"all but {next(name for name in defects if name not in here)}"
        return f"from {next(name for name in defects if name in here)} on"

    def one_after_the_other(self) -> list[tuple[str, ...]]:
        """Defects present from all to none, corrected in their order."""
        return [self.defects[mended:] for mended in range(len(self.defects) + 1)]

    def alone(self) -> list[tuple[str, ...]]:
        """Each defect on its own."""
        return [(name,) for name in self.defects]

    def mended_alone(self) -> list[tuple[str, ...]]:
        """All defects but one, each in turn."""
        return [tuple(other for other in self.defects if other != name) for name in self.defects]

    def cases(self) -> dict[str, tuple[str, ...]]:
        """Defects present by the name of the case: each case once, in order."""
        listed = [*self.one_after_the_other(), *self.alone(), *self.mended_alone()]
        return {self.label(present): present for present in listed}


def changes(defects: Mapping[str, Mapping[str, Any]], present: Sequence[str]) -> dict[str, Any]:
    """Values by dotted path that make a config have these defects."""
    return {path: value for name in present for path, value in defects[name].items()}


def slug(label: str) -> str:
    """Name of a case as part of a file name."""
    return re.sub(r"[^a-z0-9]+", "_", label.lower()).strip("_")
