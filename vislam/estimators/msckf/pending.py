"""Observations that wait for the end of their track, and the tracks that have ended, packed."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.frame import Frame


@dataclass(frozen=True)
class Packed:
    """Tracks with all their observations, padded to the same length.

    Attributes
    ----------
    track : (n,)
    seen : (n, V)
        Which observations there are: the first ones of each row.
    frame : (n, V)
        Frames of the observations; that of the first one where there is none.
    z, sigma : (n, V, 3)
        Measurements (uL, uR, v) and their standard deviations [px], infinite where there is none.
    """

    track: IntArray
    seen: BoolArray
    frame: IntArray
    z: Array
    sigma: Array

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.track)

    @property
    def length(self) -> IntArray:
        """Observations of each track, ``(n,)``."""
        return np.asarray(self.seen.sum(axis=1))

    def part(self, mask: BoolArray) -> "Packed":
        """Those tracks that a mask ``(n,)`` has."""
        return Packed(self.track[mask], self.seen[mask], self.frame[mask], self.z[mask], self.sigma[mask])

    def pairs(self) -> tuple[IntArray, IntArray]:
        """Frame and track of each observation."""
        track = np.broadcast_to(self.track[:, None], self.seen.shape)
        return self.frame[self.seen], track[self.seen]


class Pending:
    """Observations of the tracks in view, in the order in which they came in."""

    def __init__(self) -> None:
        self._track: IntArray = np.empty(0, np.int64)
        self._frame: IntArray = np.empty(0, np.int64)
        self._values: Array = np.empty((0, 6))

    def take(self, frame: Frame) -> None:
        """Add what may be fused of a frame."""
        stereo, rows = frame.stereo, np.flatnonzero(frame.stereo.usable)
        self._track = np.concatenate([self._track, stereo.track[rows]])
        self._frame = np.concatenate([self._frame, np.full(len(rows), frame.k)])
        self._values = np.concatenate([self._values, np.hstack([stereo.z[rows], stereo.sigma[rows]])])

    def release(self, in_view: IntArray, *, longest: int, oldest: int) -> Packed:
        """Give out the tracks that have ended; their observations are forgotten here.

        Parameters
        ----------
        in_view : (n,)
            Tracks that the last frame has.
        longest : int
            Tracks with as many observations are given out, too.
        oldest : int
            And so are tracks with observations of this frame or an earlier one: their poses are about to
            leave the window.
        """
        track, member, length = np.unique(self._track, return_inverse=True, return_counts=True)
        first = np.full(len(track), np.iinfo(np.int64).max)
        np.minimum.at(first, member, self._frame)
        ended = ~np.isin(track, in_view) | (length >= longest) | (first <= oldest)
        going = ended[member]
        packed = _pack(self._track[going], self._frame[going], self._values[going])
        self._track, self._frame = self._track[~going], self._frame[~going]
        self._values = self._values[~going]
        return packed


def _pack(track: IntArray, frame: IntArray, values: Array) -> Packed:
    """Pack observations ``(N,)``, which are in the order of time."""
    names, member, length = np.unique(track, return_inverse=True, return_counts=True)
    order = np.argsort(member, kind="stable")
    seen = np.arange(int(length.max(initial=1))) < length[:, None]
    start = order[np.cumsum(length) - length]
    frames = np.repeat(frame[start][:, None], seen.shape[1], axis=1)
    padded = np.repeat(values[start][:, None], seen.shape[1], axis=1)
    frames[seen], padded[seen] = frame[order], values[order]
    sigma = np.where(seen[:, :, None], padded[:, :, 3:], np.inf)
    return Packed(names, seen, frames, padded[:, :, :3], sigma)
