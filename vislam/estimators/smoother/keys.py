"""Keys of the graph.

``X(k)`` are the poses, ``W(k)`` the twist of the step to frame k less its bias, ``V(k)`` a twist at its end
that nothing else asks for (see :mod:`vislam.estimators.smoother.motion`), ``B(k)`` the twist of the body
itself, where it is supposed to move smoothly (by raw inertia ``V(k)`` is the velocity and ``B(k)`` both
biases: :mod:`vislam.estimators.smoother.inertial`), ``H(k)`` the height as the vertical velocity has led, and
``A(k)`` the anchor beside a pose (see :class:`vislam.estimators.smoother.tree.Ordered`). Errors that all
tracks share have an index of 0 where they are constant, and that of the frame where they walk: ``C`` what is
left of the clock offset, ``D`` the direction of the velocity in the body, ``Y`` the rotation of the cameras
(:mod:`vislam.estimators.smoother.twist_errors`), ``F`` and ``G`` the calibrations of the left and the right
camera, ``E`` their mountings (:mod:`vislam.estimators.smoother.pixel_errors`). The letter of a landmark tells
its depth.

iSAM2 takes its relinearisation thresholds by letter. A landmark 100 m away that moves by 1 m changes
nothing; one at 5 m does. So the letter of a landmark is that of its depth, by half octaves, and each
letter gets a threshold that is the same share of the depth.
"""

from collections.abc import Mapping

import gtsam
import numpy as np
from gtsam.symbol_shorthand import A, B, C, D, E, F, G, H, V, W, X, Y

from vislam.base.types import Array

_LETTERS = "DEFGIJKLMNijklmnopqrstu"
_NEAREST = 0.125
"""Depth up to which the first letter goes [m]; the last one begins at 181 m."""
_NEVER = 1e3
LINEAR: Mapping[str, Array] = {
    letter: np.full(size, _NEVER)
    for letter, size in (("w", 6), ("v", 6), ("b", 6), ("h", 3), ("c", 1), ("d", 2), ("y", 3))
}
"""Thresholds of the variables beside the recorded twist, which enter the factors linearly, or nearly so."""

PIXEL_ERRORS: Mapping[str, Array] = {"e": np.full(6, _NEVER), "f": np.full(5, 0.3), "g": np.full(5, 0.3)}
"""Those of mountings, and of calibrations, whose product with a change of the points is small [px]."""

__all__ = ["A", "B", "C", "D", "E", "F", "G", "H", "V", "W", "X", "Y"]
__all__ += ["LINEAR", "PIXEL_ERRORS", "is_landmark", "landmark", "thresholds"]


def landmark(number: int, depth: float) -> int:
    """Key of a landmark first placed at a depth [m]."""
    octave = int(np.ceil(2.0 * np.log2(max(depth, _NEAREST) / _NEAREST)))
    key: int = gtsam.symbol(_LETTERS[min(octave, len(_LETTERS) - 1)], number)
    return key


def is_landmark(key: int) -> bool:
    """Whether a key is that of a landmark."""
    return chr(gtsam.symbolChr(key)) in _LETTERS


def thresholds(*, pose: Array, depth_share: float, own: Mapping[str, Array]) -> gtsam.ISAM2ThresholdMap:
    """Relinearisation thresholds: poses (6,) [rad, m], landmarks as a share of their depth.

    And those of the ``own`` variables of a model of motion, by their letters; anchors never are.
    """
    table = gtsam.ISAM2ThresholdMap()
    table.insert(("x", pose))
    table.insert(("a", np.full(6, _NEVER)))
    for letter, least in own.items():
        table.insert((letter, least))
    for octave, letter in enumerate(_LETTERS):
        table.insert((letter, np.full(3, depth_share * _NEAREST * 2.0 ** (octave / 2.0))))
    return table
