"""Takes a strip of small pictures while a recording is tracked."""

import base64
from itertools import pairwise

import cv2
import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.strip import LEFT_OUT, Strip
from vislam.frontend.decoding import Picture
from vislam.frontend.tracks import Tracks

_MOST = 24
"""Pictures of a strip."""
_WIDEST = 560
"""Width of each, at most [px]."""
_MOST_BYTES = 36_000
"""Of each JPEG; in base64, all of them are 1.2 MB at most."""
_QUALITIES = (75, 60, 45, 30, 15, 5)


class StripTaker:
    """Takes pictures evenly over a recording.

    Parameters
    ----------
    pairs : int
        Of the recording.
    """

    def __init__(self, pairs: int) -> None:
        self._due = (
            np.unique(np.linspace(0, max(pairs - 1, 0), min(pairs, _MOST)).round()).astype(int).tolist()
        )
        self._taken: list[tuple[int, str, Tracks]] = []
        self._size, self._scale = (1, 1), 1.0

    def offer(self, index: int, picture: Picture, tracks: Tracks, *, frame: int) -> None:
        """Take the picture of a pair if one is due, else do nothing.

        Parameters
        ----------
        index : int
            Of the pair in the recording.
        picture : Picture
            The left one.
        tracks : Tracks
            In view in it.
        frame : int
            Of the sequence.
        """
        if not self._due or index < self._due[0]:
            return
        while self._due and self._due[0] <= index:
            self._due.pop(0)
        height, width = picture.shape
        self._scale = min(1.0, _WIDEST / width)
        self._size = (max(round(width * self._scale), 1), max(round(height * self._scale), 1))
        small = cv2.resize(picture, self._size, interpolation=cv2.INTER_AREA)
        self._taken.append((frame, _packed(np.asarray(small, dtype=np.uint8)), tracks))

    def strip(self, rows: list[IntArray]) -> Strip:
        """The strip.

        Parameters
        ----------
        rows : list of (n,)
            For each frame, the rows of its tracks in the file, ``LEFT_OUT`` for those that are in none.
        """
        left: list[Array] = [tracks.left * self._scale for _, _, tracks in self._taken]
        counts = [len(one) for one in left]
        return Strip(
            width=self._size[0],
            height=self._size[1],
            jpeg=tuple(jpeg for _, jpeg, _ in self._taken),
            frame=np.array([frame for frame, _, _ in self._taken], dtype=np.int64),
            picture=np.repeat(np.arange(len(counts)), counts),
            left=np.vstack([np.empty((0, 2)), *left]),
            row=np.concatenate([np.empty(0, np.int64), *(rows[frame] for frame, _, _ in self._taken)]),
        )


def rows_by_frame(kept: BoolArray, offset: IntArray) -> list[IntArray]:
    """Rows in the file of the observations of each frame.

    Parameters
    ----------
    kept : (n,)
        Mask of the observations that are in the file.
    offset : (T + 1,)
        Where each frame begins.
    """
    row = np.where(kept, np.cumsum(kept) - 1, LEFT_OUT)
    return [row[begin:end] for begin, end in pairwise(offset.tolist())]


def _packed(picture: Picture) -> str:
    """JPEG in base64, of the best quality that has room."""
    for quality in _QUALITIES:
        content = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()
        if len(content) <= _MOST_BYTES:
            break
    return base64.b64encode(content).decode("ascii")
