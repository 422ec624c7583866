"""Tracks in view in one frame."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.sequence import stereo_triples


@dataclass(frozen=True)
class Tracks:
    """Tracks in view in one frame.

    Attributes
    ----------
    track : (n,)
        Ids; one that is missing once never comes back.
    left, right : (n, 2)
        Pixels in the images as they are [px].
    pixels : (n, 4)
        Rectified (uL, vL, uR, vR) [px].
    distance : (n, 2)
        Forward-backward distance from the frame before (0 for a new track) and to the right image [px].
    """

    track: IntArray
    left: Array
    right: Array
    pixels: Array
    distance: Array

    @classmethod
    def none(cls) -> "Tracks":
        """No track."""
        two = np.empty((0, 2))
        return cls(np.empty(0, np.int64), two, two, np.empty((0, 4)), two)

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.track)

    def of(self, keep: BoolArray) -> "Tracks":
        """The tracks of a mask."""
        return Tracks(
            self.track[keep], self.left[keep], self.right[keep], self.pixels[keep], self.distance[keep]
        )

    def with_more(self, other: "Tracks") -> "Tracks":
        """These and others."""
        return Tracks(
            np.concatenate([self.track, other.track]),
            np.vstack([self.left, other.left]),
            np.vstack([self.right, other.right]),
            np.vstack([self.pixels, other.pixels]),
            np.vstack([self.distance, other.distance]),
        )

    @property
    def z(self) -> Array:
        """Stereo measurements (uL, uR, v), ``(n, 3)`` [px]."""
        return stereo_triples(self.pixels)
