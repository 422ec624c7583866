"""New corners (Shi and Tomasi 1994), shared out over a grid, away from the tracks that are there."""

import cv2
import numpy as np

from vislam.base.types import Array, IntArray
from vislam.frontend.decoding import Picture
from vislam.frontend.settings import FrontEndConfig

_BLOCK = 5


def new_corners(
    picture: Picture, taken: Array, *, config: FrontEndConfig, wanted: int, yield_of: Array
) -> Array:
    """Corners ``(m, 2)`` [px] for the emptiest cells first, the strongest in each; as many as wanted at most.

    Parameters
    ----------
    picture : Picture
    taken : (n, 2)
        Pixels of the tracks in view, from which they keep their distance.
    config : FrontEndConfig
    wanted : int
    yield_of : (cells,)
        Share of a cell's corners that became tracks of late; a cell of half the yield is filled half as much.
    """
    if wanted < 1:
        return np.empty((0, 2))
    found = cv2.goodFeaturesToTrack(
        picture,
        maxCorners=0,
        qualityLevel=config.quality,
        minDistance=config.distance_px,
        mask=_free(picture, taken, config),
        blockSize=_BLOCK,
    )
    if found is None:
        return np.empty((0, 2))
    corners = np.asarray(found, dtype=np.float64).reshape(-1, 2)
    # They come strongest first. In each cell they queue behind the tracks that it has.
    cell, occupied = cells(corners, picture, config), cells(taken, picture, config)
    place = (1 + _rank(cell) + np.bincount(occupied, minlength=len(yield_of))[cell]) / yield_of[cell]
    return corners[np.argsort(place, kind="stable")[:wanted]]


def _free(picture: Picture, taken: Array, config: FrontEndConfig) -> Picture:
    """Where corners may be: inside, and away from those that are taken."""
    margin = config.window_px // 2
    free = np.zeros_like(picture)
    free[margin:-margin, margin:-margin] = 255
    for column, row in np.rint(taken).astype(int).tolist():
        cv2.circle(free, (column, row), round(config.distance_px), 0, thickness=-1)
    return free


def cells(pixels: Array, picture: Picture, config: FrontEndConfig) -> IntArray:
    """Index of the cell of each pixel, ``(n,)``."""
    height, width = picture.shape
    columns, rows = config.grid
    column = np.clip((pixels[:, 0] * columns / width).astype(np.int64), 0, columns - 1)
    row = np.clip((pixels[:, 1] * rows / height).astype(np.int64), 0, rows - 1)
    return np.asarray(row * columns + column)


def _rank(group: IntArray) -> IntArray:
    """How many before it each has in its own group, ``(n,)``."""
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    rank = np.empty_like(group)
    rank[order] = np.arange(len(group)) - np.searchsorted(ordered, ordered)
    return rank
