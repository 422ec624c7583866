"""Frames into which nothing has moved, by the tracks."""

import numpy as np

from vislam.base.arrays import runs
from vislam.base.types import Array, BoolArray
from vislam.core.rigid_fit import FEWEST, continuations
from vislam.core.sequence import Sequence

_FLOW_PX = 0.3
"""Median flow of a frame's tracks below which nothing moves [px]."""


def still_frames(sequence: Sequence) -> BoolArray:
    """Mask ``(T,)`` of the frames into which nothing has moved.

    Frames that repeat the pixels of the frame before bit for bit say nothing of the motion.
    """
    pairs, pixels = continuations(sequence), sequence.pixels
    flow = np.linalg.norm(pixels[pairs.after, :2] - pixels[pairs.before, :2], axis=1)
    out = np.zeros(len(sequence), dtype=bool)
    for k in np.flatnonzero(np.diff(pairs.start) >= FEWEST):
        of_frame = flow[pairs.start[k] : pairs.start[k + 1]]
        out[k] = 0.0 < float(np.median(of_frame)) < _FLOW_PX
    return out


def stops(still: BoolArray, dt: Array, *, shortest: float) -> list[slice]:
    """Runs of frames that are still for long enough.

    Parameters
    ----------
    still : (T,)
    dt : (T,)
        Length of the step into each frame [s].
    shortest : float
        [s].
    """
    return [slice(*run) for run in runs(still) if float(dt[slice(*run)].sum()) >= shortest]
