"""Tracks in view in one frame."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.sequence import stereo_triples
from vislam.models.stereo_pair import StereoPair


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

    @classmethod
    def seen(
        cls, pair: StereoPair, track: IntArray, left: Array, right: Array, distance: Array | None = None
    ) -> "Tracks":
        """Tracks by their pixels in both images, rectified; those without a ray are left out.

        Parameters
        ----------
        pair : StereoPair
        track : (n,)
            Ids >= 0.
        left, right : (n, 2)
            Pixels in the images as they are [px].
        distance : (n, 2), optional
            What is known of their quality, as forward-backward distance [px]; 0 if not given.
        """
        pixels = np.hstack([pair.rectify_left(left), pair.rectify_right(right)])
        distance = np.zeros((len(track), 2)) if distance is None else distance
        return cls(track, left, right, pixels, distance).of(np.asarray(np.isfinite(pixels).all(axis=1)))

    def __len__(self) -> int:
        """Return the number of tracks."""
        return len(self.track)

    def of(self, keep: BoolArray) -> "Tracks":
        """The tracks of a mask."""
        return Tracks(
            self.track[keep], self.left[keep], self.right[keep], self.pixels[keep], self.distance[keep]
        )

    def by_id(self) -> "Tracks":
        """The same in the order of the ids, as a file of tracks has them."""
        order = np.argsort(self.track, kind="stable")
        return Tracks(
            self.track[order], self.left[order], self.right[order], self.pixels[order], self.distance[order]
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
