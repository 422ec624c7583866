"""Bias of the twist where the vehicle stands still: the one evidence of it that needs no calibrated camera.

A camera finds a bias by its own motion, and an error of its rotation, scale or principal point in it. What
does not move in the image does not move, whatever the calibration is.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.core.sequence import Sequence
from vislam.core.still import still_frames, stops

_SHORTEST_S = 1.0
"""Of a stop that is used."""
_AXES = 5
"""The third component of the velocity may be another instrument's, or replaced."""


@dataclass(frozen=True)
class Standstill:
    """Bias ``(6,)`` and its standard deviation, infinite where nothing is known of it; frames at rest."""

    bias: Array
    sigma: Array
    frames: int

    @property
    def known(self) -> BoolArray:
        """Components that it tells."""
        return np.isfinite(self.sigma)


UNKNOWN = Standstill(np.zeros(6), np.full(6, np.inf), 0)
"""Nothing is known."""


def standstill(sequence: Sequence) -> Standstill:
    """Mean twist over all stops of a recording.

    Frames that repeat the pixels of the frame before bit for bit say nothing of the motion.
    """
    still = np.zeros(len(sequence), dtype=bool)
    dt = np.diff(sequence.stamp, prepend=sequence.stamp[0])
    for run in stops(still_frames(sequence), dt, shortest=_SHORTEST_S):
        still[run] = True
    bias, sigma = np.zeros(6), np.full(6, np.inf)
    count = int(still.sum())
    if count >= 2:
        twist = sequence.step_means()[0][still]
        spread = twist.std(axis=0, ddof=1)
        # Successive steps share samples, and the noise of a stop is no white one.
        runs = max(1, int(np.sum(np.diff(still.astype(np.int64)) == 1)))
        bias[:_AXES] = twist.mean(axis=0)[:_AXES]
        sigma[:_AXES] = (spread / np.sqrt(runs))[:_AXES]
    return Standstill(bias, sigma, count)
