"""Cross-validation of a calibration: alternate blocks of time, each predicted by what the others say.

The maximum without a block's frames is one Newton step from that of all: ``theta - H^-1 g``, with g the score
of the block and H the information of the rest (the one-step estimator; Le Cam 1956). So each fold costs one
run of the filter, not a search.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base import linear
from vislam.base.types import Array, IntArray
from vislam.calibration.search import Maximum

FOLDS = 4
_LONGEST_BLOCK, _SHORTEST_BLOCK = 25, 3
"""Frames of a block."""


@dataclass(frozen=True)
class Predicted:
    """How parts of a recording that were not fitted are predicted, against the config from before.

    Attributes
    ----------
    gain : (b,)
        Log likelihood that each block has gained.
    """

    gain: Array

    @property
    def total(self) -> float:
        """Of all blocks."""
        return float(self.gain.sum())

    @property
    def sigma(self) -> float:
        """Standard deviation of the total, by the spread of the blocks."""
        many = len(self.gain)
        return float(np.sqrt(many) * self.gain.std(ddof=1)) if many > 1 else float("inf")

    @property
    def better(self) -> int:
        """Blocks that are predicted better."""
        return int(np.count_nonzero(self.gain > 0.0))


def block_of(frames: int) -> IntArray:
    """Block of each frame, ``(T,)``; fold f has the blocks f, f + FOLDS, ..., so that all parts are in each.

    Empty where a recording is too short for two blocks a fold.
    """
    many = min(6 * FOLDS, max(2 * FOLDS, frames // _LONGEST_BLOCK))
    if frames < many * _SHORTEST_BLOCK:
        return np.empty(0, dtype=np.int64)
    return np.arange(frames) * many // frames


def left_out(maximum: Maximum, fold: Array, *, lowest: Array, largest: Array) -> Array:
    """Maximum ``(p,)`` of the frames outside of a fold's mask ``(T,)``."""
    free = np.isfinite(maximum.sigma)
    point = maximum.point.copy()
    score = maximum.scores[fold].sum(axis=0)[free]
    information = (1.0 - fold.mean()) * maximum.information[np.ix_(free, free)]
    point[free] -= np.clip(linear.solve(information, score), -largest[free], largest[free])
    return np.maximum(point, lowest)


def predicted(before: Array, after: list[Array], block: IntArray) -> Predicted:
    """Gain of each block from log likelihoods ``(T,)`` before, and after by fold."""
    fold = block % FOLDS
    chosen = np.choose(fold, after)
    finite = np.nan_to_num(chosen - before, nan=0.0, posinf=0.0, neginf=-1e9)
    return Predicted(np.bincount(block, finite).astype(float))
