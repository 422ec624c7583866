"""Bias of the twist where the vehicle stands still: the one evidence of it that needs no calibrated camera.

A camera finds a bias by its own motion, and an error of its rotation, scale or principal point in it. What
does not move in the image does not move, whatever the calibration is.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.core.rigid_fit import FEWEST, continuations
from vislam.core.sequence import Sequence
from vislam.core.standstill import runs

_FLOW_PX = 0.3
"""Median flow of a frame's tracks below which nothing moves [px]."""
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
    still = _stops(_still(sequence), np.diff(sequence.stamp, prepend=sequence.stamp[0]))
    bias, sigma = np.zeros(6), np.full(6, np.inf)
    count = int(still.sum())
    if count >= 2:
        twist = sequence.step_means()[0][still]
        spread = twist.std(axis=0, ddof=1)
        # Successive steps share samples, and the noise of a stop is no white one.
        stops = max(1, int(np.sum(np.diff(still.astype(np.int64)) == 1)))
        bias[:_AXES] = twist.mean(axis=0)[:_AXES]
        sigma[:_AXES] = (spread / np.sqrt(stops))[:_AXES]
    return Standstill(bias, sigma, count)


def _still(sequence: Sequence) -> BoolArray:
    """Mask ``(T,)`` of the frames into which nothing has moved."""
    pairs, pixels = continuations(sequence), sequence.pixels
    flow = np.linalg.norm(pixels[pairs.after, :2] - pixels[pairs.before, :2], axis=1)
    out = np.zeros(len(sequence), dtype=bool)
    for k in np.flatnonzero(np.diff(pairs.start) >= FEWEST):
        of_frame = flow[pairs.start[k] : pairs.start[k + 1]]
        out[k] = 0.0 < float(np.median(of_frame)) < _FLOW_PX
    return out


def _stops(still: BoolArray, dt: Array) -> BoolArray:
    """Those of them that are part of a stop that is long enough."""
    out = np.zeros(len(still), dtype=bool)
    for first, end in runs(still):
        out[first:end] = float(dt[first:end].sum()) >= _SHORTEST_S
    return out
