"""Landmarks that a lag has marginalised: of each what the final estimate needs, in a few bytes."""

from array import array
from collections.abc import Collection, Sequence

import numpy as np

from vislam.base.types import Array, IntArray


class Past:
    """Landmarks in the order in which they came, as arrays.

    A track with its observations takes kilobytes, and a long sequence has hundreds of thousands of them.
    """

    def __init__(self) -> None:
        self._id, self._views, self._frame = array("q"), array("q"), array("q")
        self._point = array("d")
        # Of the map: those whose track has not gone on to another landmark.
        self._place: dict[int, int] = {}

    def add(self, track: int, frames: Sequence[int], point: Array, *, replaced: bool = False) -> None:
        """Keep a landmark; where another one takes its place, it is not of the map any more.

        Parameters
        ----------
        track : int
            Its track's id.
        frames : sequence of int
            In which it was observed.
        point : (3,)
            [m].
        replaced : bool
        """
        if not replaced:
            self._place[track] = len(self._id)
        self._id.append(track)
        self._views.append(len(frames))
        self._frame.extend(frames)
        self._point.extend(point.tolist())

    def come_back(self, present: Collection[int]) -> list[int]:
        """Landmarks of tracks that are seen again, which leave the map: each waits for another one."""
        found = sorted(self._place.keys() & present)
        for name in found:
            del self._place[name]
        return found

    @property
    def landmarks(self) -> tuple[IntArray, Array]:
        """Ids ``(m,)`` and points ``(m, 3)`` [m] of those of the map."""
        rows = np.fromiter(self._place.values(), np.int64, len(self._place))
        ids, points = np.array(self._id, dtype=np.int64), np.array(self._point).reshape(-1, 3)
        return ids[rows], points[rows]

    @property
    def observations(self) -> tuple[IntArray, IntArray]:
        """Frames and ids ``(n,)`` of all observations of all of them."""
        ids = np.repeat(np.array(self._id, dtype=np.int64), np.array(self._views, dtype=np.int64))
        return np.array(self._frame, dtype=np.int64), ids
