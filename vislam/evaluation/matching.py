"""Which rows of a trajectory and of a reference belong together, on the stamps that both came with."""

from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.stamped import Stamped, nearest

Association = Literal["auto", "nearest", "interpolate"]
"""
nearest
    Each row of the sparser side with the nearest of the denser one, within a tolerance: evo's way.
interpolate
    The denser side is interpolated at the stamps of the sparser one; never across its gaps.
auto
    Nearest, unless that leaves out more than half of what interpolation finds.
"""
_ENOUGH = 0.5
_SAME_FRAME = 0.5


@dataclass(frozen=True)
class Matching:
    """How rows are matched.

    Attributes
    ----------
    association : Association
    tolerance : float
        Farthest that two stamps may be apart to be taken for the same [s].
    start, end : float
        Times of the reference before and after which nothing is scored [s], from its first row on.
    """

    association: Association = "auto"
    tolerance: float = 0.01
    start: float = 0.0
    end: float = float("inf")


@dataclass(frozen=True)
class Paired:
    """Rows of both sides that belong together.

    Attributes
    ----------
    row : (m,)
        Of the trajectory, or of the reference where the trajectory is interpolated.
    estimate, reference : Stamped
        At these rows.
    interpolated : "", "estimate" or "reference"
        The side that is; none by default.
    estimate_rows, reference_rows : int
        How many there were, after the crop.
    common : int
        Rows of the sparser side while there is the other one, too.
    apart : (m,)
        Between the stamps of both sides [s].
    """

    row: IntArray
    estimate: Stamped
    reference: Stamped
    interpolated: str
    estimate_rows: int
    reference_rows: int
    common: int
    apart: Array = field(default_factory=lambda: np.empty(0))

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.row)

    @property
    def share(self) -> float:
        """Share of the rows of the sparser side that are matched [%]."""
        return 100.0 * len(self) / max(min(self.estimate_rows, self.reference_rows), 1)

    @property
    def how(self) -> str:
        """How they were matched, in words."""
        if not self.estimate.timed:
            return "by the numbers of the frames"
        if self.interpolated:
            side = "trajectory" if self.interpolated == "estimate" else "reference"
            return f"{side} interpolated at the stamps of the other"
        return f"nearest stamps, up to {1e3 * self.apart.max(initial=0.0):.3g} ms apart"


def match(estimate: Stamped, reference: Stamped, settings: Matching) -> Paired:
    """Match a trajectory with a reference, whose positions may lack a height; maybe with no pair."""
    first = reference.stamp[0] if len(reference) else 0.0
    low, high = first + settings.start, first + settings.end
    estimate = estimate.take((estimate.stamp >= low) & (estimate.stamp <= high))
    reference = reference.take((reference.stamp >= low) & (reference.stamp <= high))
    if not estimate.timed:
        return _nearest(estimate, reference, _SAME_FRAME)
    if settings.association == "interpolate":
        return _interpolated(estimate, reference)
    found = _nearest(estimate, reference, settings.tolerance)
    if settings.association == "auto" and len(found) < _ENOUGH * found.common:
        other = _interpolated(estimate, reference)
        return other if len(found) < _ENOUGH * len(other) else found
    return found


def _common(estimate: Stamped, reference: Stamped) -> int:
    if not len(estimate) or not len(reference):
        return 0
    low = max(estimate.stamp[0], reference.stamp[0])
    high = min(estimate.stamp[-1], reference.stamp[-1])
    sparse = estimate if len(estimate) <= len(reference) else reference
    return int(np.count_nonzero((sparse.stamp >= low) & (sparse.stamp <= high)))


def _nearest(estimate: Stamped, reference: Stamped, tolerance: float) -> Paired:
    if len(estimate) <= len(reference):
        own, other = nearest(estimate.stamp, reference.stamp, tolerance)
    else:
        other, own = nearest(reference.stamp, estimate.stamp, tolerance)
    return Paired(
        own,
        estimate.take(own),
        reference.take(other),
        "",
        len(estimate),
        len(reference),
        _common(estimate, reference),
        np.abs(estimate.stamp[own] - reference.stamp[other]),
    )


def _interpolated(estimate: Stamped, reference: Stamped) -> Paired:
    sizes = len(estimate), len(reference), _common(estimate, reference)
    if len(estimate) <= len(reference):
        row = np.flatnonzero(reference.within(estimate.stamp))
        own = estimate.take(row)
        return Paired(row, own, _at(reference, own.stamp), "reference", *sizes)
    row = np.flatnonzero(estimate.within(reference.stamp))
    other = reference.take(row)
    return Paired(row, _at(estimate, other.stamp), other, "estimate", *sizes)


def _at(side: Stamped, at: Array) -> Stamped:
    return side.interpolated(at) if len(side) > 1 and len(at) else side.take(np.isin(side.stamp, at))
