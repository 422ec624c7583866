"""Patches followed from one image to another and back (pyramidal Lucas-Kanade, Bouguet 2001)."""

import cv2
import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.frontend.decoding import Picture
from vislam.frontend.settings import FrontEndConfig

_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 30, 0.005)
_FLATTEST = 1e-4
"""Smallest eigenvalue of a patch that can be followed, in OpenCV's unit."""


def follow(
    first: Picture,
    second: Picture,
    start: Array,
    *,
    guess: Array,
    levels: int,
    farthest: float,
    config: FrontEndConfig,
) -> tuple[Array, Array, BoolArray]:
    """Follow patches to another image and back.

    The backward flow begins as far off as the forward flow did, so that it is a test and not a repetition.

    Parameters
    ----------
    first, second : Picture
    start : (n, 2)
        Where they are in the first [px].
    guess : (n, 2)
        Where they are supposed in the second [px].
    levels : int
        Levels of the pyramid: few for a good guess, as a coarse patch holds more than the surface it is on.
    farthest : float
        Largest forward-backward error at which a patch is found [px].
    config : FrontEndConfig

    Returns
    -------
    end : (n, 2)
        Where they are in the second [px].
    distance : (n,)
        Forward-backward error of each [px].
    found : (n,)
        Which of them were found both ways, near enough, and inside the second image.
    """
    if not len(start):
        return start, np.empty(0), np.zeros(0, bool)
    end, there = _one_way(first, second, start, guess=guess, levels=levels, config=config)
    # The guess was off by end - guess; the backward flow is given one that is off by as much.
    back, again = _one_way(second, first, end, guess=start - guess + end, levels=levels, config=config)
    distance = np.linalg.norm(back - start, axis=1)
    inside = within(end, second, margin=config.window_px // 2)
    return end, distance, there & again & inside & (distance <= farthest)


def within(pixels: Array, picture: Picture, *, margin: float) -> BoolArray:
    """Mask ``(n,)`` of the pixels ``(n, 2)`` that lie in an image, this far from its border; NaN does not."""
    height, width = picture.shape
    inside = (pixels >= margin) & (pixels <= [width - 1 - margin, height - 1 - margin])
    return np.asarray(inside.all(axis=1))


def _one_way(
    first: Picture, second: Picture, start: Array, *, guess: Array, levels: int, config: FrontEndConfig
) -> tuple[Array, BoolArray]:
    end, status, _ = cv2.calcOpticalFlowPyrLK(
        first,
        second,
        start.astype(np.float32)[:, None],
        guess.astype(np.float32)[:, None].copy(),
        winSize=(config.window_px, config.window_px),
        maxLevel=levels,
        criteria=_STOP,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=_FLATTEST,
    )
    found = np.asarray(status).reshape(-1) == 1
    return np.asarray(end, dtype=np.float64).reshape(-1, 2), found
