"""Keys of the graph: ``X(k)`` poses, ``B(k)`` biases, and landmarks whose letter tells their depth.

iSAM2 takes its relinearisation thresholds by letter. A landmark 100 m away that moves by 1 m changes
nothing; one at 5 m does. So the letter of a landmark is that of its depth, by half octaves, and each
letter gets a threshold that is the same share of the depth.
"""

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, X

from vislam.types import Array

_LETTERS = "lmnopqrstu"
_NEAREST = 8.0
"""Depth up to which the first letter goes [m]."""

__all__ = ["B", "X", "landmark", "thresholds"]


def landmark(track: int, depth: float) -> int:
    """Key of a landmark first placed at a depth [m]."""
    octave = int(np.ceil(2.0 * np.log2(max(depth, _NEAREST) / _NEAREST)))
    key: int = gtsam.symbol(_LETTERS[min(octave, len(_LETTERS) - 1)], track)
    return key


def thresholds(*, pose: Array, bias: Array, depth_share: float) -> gtsam.ISAM2ThresholdMap:
    """Relinearisation thresholds: poses (6,) [rad, m], biases (6,), landmarks as a share of their depth."""
    table = gtsam.ISAM2ThresholdMap()
    table.insert(("x", pose))
    table.insert(("b", bias))
    for octave, letter in enumerate(_LETTERS):
        table.insert((letter, np.full(3, depth_share * _NEAREST * 2.0 ** (octave / 2.0))))
    return table
