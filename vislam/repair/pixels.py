"""Repairs of single observations: their disparity and their rows."""

from dataclasses import replace

import numpy as np
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, Positive
from vislam.core.sequence import Sequence


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DisparityOffset:
    """Take a constant error out of all disparities."""

    pixels: float
    """How much too large the disparities are [px]."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Move the right column."""
        pixels = sequence.pixels.copy()
        pixels[:, 2] += self.pixels
        return replace(sequence, pixels=pixels)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Disparity:
    """Drop what cannot be a stereo observation, and tracks that start too far away to have a depth.

    Once started, a track keeps every observation of positive disparity, lest the gate pick the noise
    that makes it near.
    """

    minimum_px: Positive = 2.5
    """Smallest disparity uL - uR at which a track may start [px]."""
    row_difference_px: Positive = 2.0
    """Largest |vL - vR| of an observation [px]."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Drop them."""
        pixels = sequence.pixels
        disparity = sequence.disparity
        rows_differ = np.abs(pixels[:, 1] - pixels[:, 3]) > self.row_difference_px
        impossible = ~rows_differ & (disparity <= 0)
        possible = ~rows_differ & ~impossible
        begins = np.where(possible & (disparity >= self.minimum_px), sequence.frame_of, len(sequence))
        first = np.full(int(sequence.track.max(initial=-1)) + 1, len(sequence))
        np.minimum.at(first, sequence.track, begins)
        keep = possible & (sequence.frame_of >= first[sequence.track])
        return sequence.select(
            keep,
            dropped_row_difference=int(rows_differ.sum()),
            dropped_disparity_not_positive=int(impossible.sum()),
            dropped_too_far_to_start=int(np.sum(possible & ~keep)),
        )
