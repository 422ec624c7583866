"""A few small images of a recording with the observations in them, saved beside its tracks."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, StringConstraints

from vislam.base.errors import DataError
from vislam.base.types import Array, IntArray
from vislam.core.archive import read_archive, write_archive
from vislam.core.schema import INCREASING, NOT_NEGATIVE, SORTED, Plain, Table, real, whole

LEFT_OUT, HELD_OUT = -1, -2
"""In place of a row: observations that nobody is given, and those of tracks that are kept from all."""
_MOST = 64
_Side = Annotated[int, Field(ge=1, le=1 << 12)]
_Jpeg = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9+/]+=*$", max_length=1 << 18)]
_WHAT = "a strip of pictures"
TABLE: Table = {
    "width": Plain(_Side),
    "height": Plain(_Side),
    "jpeg": Plain(Annotated[tuple[_Jpeg, ...], Field(max_length=_MOST)]),
    "frame": whole("p", INCREASING, NOT_NEGATIVE),
    "picture": whole("q", SORTED, NOT_NEGATIVE),
    "left": real("q 2"),
    "row": whole("q"),
}
"""The fields of a saved strip."""


@dataclass(frozen=True)
class Strip:
    """Small left images, evenly over a recording.

    Attributes
    ----------
    width, height : int
        Of each [px].
    jpeg : tuple of str
        The images, JPEG in base64.
    frame : (p,)
        Frame of each.
    picture : (q,)
        In which image each observation is.
    left : (q, 2)
        Where in it [px].
    row : (q,)
        Which observation of the tracks it is; ``LEFT_OUT`` or ``HELD_OUT``.
    """

    width: int
    height: int
    jpeg: tuple[str, ...]
    frame: IntArray
    picture: IntArray
    left: Array
    row: IntArray

    def save(self, path: Path) -> None:
        """Write it, whole or not at all."""
        write_archive(path, self)

    @classmethod
    def beside(cls, tracks: Path, *, frames: int, observations: int) -> "Strip | None":
        """The strip that was saved beside a file of tracks; None if there is none.

        Raises
        ------
        DataError
            If it cannot be read, or is of other tracks.
        """
        path = strip_path(tracks)
        if not path.is_file():
            return None
        strip = cls(**read_archive(path, TABLE, what=_WHAT))
        whole = len(strip.frame) == len(strip.jpeg) > int(strip.picture.max(initial=-1))
        if not whole or strip.frame.max(initial=-1) >= frames or strip.row.max(initial=-1) >= observations:
            raise DataError(f"{path}: must be of the tracks in {tracks.name}, got others; remove it")
        return strip

    def of_given(self, given: IntArray, held_out: IntArray) -> "Strip":
        """The same with the rows of what is given to the estimators.

        Parameters
        ----------
        given, held_out : (n,), (m,)
            Rows in the file of the tracks of the observations that are given, and of those held out.
        """
        count = int(max(given.max(initial=-1), held_out.max(initial=-1), self.row.max(initial=-1))) + 1
        becomes = np.full(count + 1, LEFT_OUT)
        becomes[given] = np.arange(len(given))
        becomes[held_out] = HELD_OUT
        # The last one stands for what no file has.
        return replace(self, row=becomes[np.where(self.row < 0, count, self.row)])


def strip_path(tracks: Path) -> Path:
    """File beside a file of tracks with a strip of its pictures."""
    return tracks.with_name(f"{tracks.stem}_strip.npz")
