"""What a trajectory file holds, whatever its format."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array, BoolArray, IntArray
from vislam.geometry.pose_covariance import CovarianceConvention


@dataclass(frozen=True)
class Rows:
    """Rows of a trajectory file.

    Attributes
    ----------
    path : Path
    format : str
    line : (n,)
        Where each row stands in the file, from 1.
    position : (n, 2) or (n, 3)
        [m].
    pose : (n, 4, 4) or None
        Of the same positions; None if the file has no attitudes.
    stamp : (n,) or None
        [s].
    frame : (n,) or None
        Numbers of the frames, where the file names them, or its place says them.
    cov : (n, 6, 6) or None
        As the file has it, NaN where it has none; of the position alone it is the block of that.
    convention : CovarianceConvention or None
        How ``cov`` is to be read, where the format says it.
    by_place : bool
        Whether the frames are the places in the file and nothing else.
    told : tuple of str
        How it was understood, and what was out of the ordinary.
    counts : dict
        What was mended or left out, and how often.
    first : dict
        Line of the first of each kind in ``counts``, and what it is, for who rejects it.
    """

    path: Path
    format: str
    line: IntArray
    position: Array
    pose: Array | None = None
    stamp: Array | None = None
    frame: IntArray | None = None
    cov: Array | None = None
    convention: CovarianceConvention | None = None
    by_place: bool = False
    told: tuple[str, ...] = ()
    counts: dict[str, int] = field(default_factory=dict)
    first: dict[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.position)

    @property
    def at(self) -> Array:
        """Stamps, or frames where there are none, ``(n,)``."""
        if self.stamp is not None:
            return self.stamp
        assert self.frame is not None
        return self.frame.astype(float)

    def take(self, rows: IntArray | BoolArray) -> "Rows":
        """These rows, by mask or index."""
        names = ("line", "position", "pose", "stamp", "frame", "cov")
        found: dict[str, Any] = {
            name: value[rows] for name in names if (value := getattr(self, name)) is not None
        }
        return replace(self, **found)

    def counting(self, what: str, rows: BoolArray, must: str, got: Any) -> "Rows":
        """Note how many rows are of some kind; ``got`` is what the first of them holds, for a message."""
        number = int(np.count_nonzero(rows))
        if not number:
            return self
        said = f"{self.path}:{self.line[int(np.argmax(rows))]}: must {must}, got {got}"
        return replace(
            self,
            counts={**self.counts, what: self.counts.get(what, 0) + number},
            first={**self.first, what: self.first.get(what, said)},
        )

    def fail(self, row: int, expected: str, got: str) -> DataError:
        """Error that names the line of a row."""
        return DataError(f"{self.path}:{self.line[row]}: must have {expected}, got {got}")
