"""Arguments and result of a reader."""

from dataclasses import dataclass
from pathlib import Path

from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.core.reference import Reference
from vislam.core.sequence import Sequence
from vislam.core.strip import Strip
from vislam.datasets.find import find_file, not_found


@dataclass(frozen=True)
class Opening:
    """Where a reader may look, and the seed of what it makes up.

    Attributes
    ----------
    folders : list of Path
        In which files are looked for, in order.
    seed : int
        Of noise that is added, or of a simulation.
    """

    folders: list[Path]
    seed: int = 0

    def find(self, name: str) -> Path:
        """Path of a file; DataError if it is not there."""
        path = find_file(name, self.folders or [Path()])
        if path is None:
            raise DataError(not_found(name, self.folders))
        return path


@dataclass(frozen=True)
class Recording:
    """A recording as its source has it; nothing is repaired.

    Attributes
    ----------
    sequence : Sequence
    reference : Reference or None
        What comes with it to score by; its landmarks are left empty, for repairs cut tracks.
    points_world : (n, 3) or None
        Reference position of the point that each observation is of, in the reference's world [m]; NaN where
        there is none.
    notes : tuple of str
        What a reader of results must know.
    strip : Strip or None
        Small pictures, where the tracks are of images.
    """

    sequence: Sequence
    reference: Reference | None = None
    points_world: Array | None = None
    notes: tuple[str, ...] = ()
    strip: Strip | None = None
