"""The right pixel of a left one: by a match of both images, or carried on from the right image before."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.frontend.decoding import Picture
from vislam.frontend.flow import follow
from vislam.frontend.settings import FrontEndConfig
from vislam.models.stereo_pair import StereoPair


@dataclass(frozen=True)
class Matches:
    """Right pixels that were found for left ones.

    Attributes
    ----------
    right : (n, 2)
        In the right image as it is [px].
    pixels : (n, 4)
        Rectified (uL, vL, uR, vR) [px].
    distance : (n,)
        Forward-backward distance [px].
    valid : (n,)
        Which of them can be.
    """

    right: Array
    pixels: Array
    distance: Array
    valid: BoolArray

    def completed(self, rows: BoolArray, other: "Matches") -> "Matches":
        """These with others in the rows of a mask."""
        right, pixels = self.right.copy(), self.pixels.copy()
        distance, valid = self.distance.copy(), self.valid.copy()
        right[rows], pixels[rows] = other.right, other.pixels
        distance[rows], valid[rows] = other.distance, other.valid
        return Matches(right, pixels, distance, valid)


def matched(
    pair: StereoPair,
    left: Picture,
    right: Picture,
    at: Array,
    *,
    disparity: Array,
    known: bool,
    config: FrontEndConfig,
) -> Matches:
    """Match left pixels ``(n, 2)`` to the right image of the same time.

    Parameters
    ----------
    pair : StereoPair
    left, right : Picture
    at : (n, 2)
        [px].
    disparity : (n,)
        As it is supposed, in the rectified pair [px].
    known : bool
        Whether it is predicted from earlier observations of the same track.
    config : FrontEndConfig
    """
    end, distance, found = follow(
        left,
        right,
        at,
        guess=right_of(pair, at, disparity),
        levels=config.predicted_levels if known else config.levels,
        farthest=config.forward_backward_px if known else config.first_forward_backward_px,
        config=config,
    )
    return _checked(pair, at, end, distance=distance, found=found, config=config)


def carried(
    pair: StereoPair,
    before: Picture,
    right: Picture,
    at: Array,
    *,
    start: Array,
    disparity: Array,
    config: FrontEndConfig,
) -> Matches:
    """Follow right pixels ``start (n, 2)`` from the right image before; the rest is as in :func:`matched`.

    An edge in front of another background in each image is the same in one image from frame to frame.
    """
    end, distance, found = follow(
        before,
        right,
        start,
        guess=right_of(pair, at, disparity),
        levels=config.predicted_levels,
        farthest=config.forward_backward_px,
        config=config,
    )
    return _checked(pair, at, end, distance=distance, found=found, config=config)


def right_of(pair: StereoPair, at: Array, disparity: Array) -> Array:
    """Right pixels ``(n, 2)`` of left ones at given disparities; the left ones where there is none."""
    rectified = pair.rectify_left(at) - np.column_stack([disparity, np.zeros(len(at))])
    guess = pair.raw_right(rectified)
    return np.where(np.isnan(guess), at, guess)


def _checked(
    pair: StereoPair, at: Array, right: Array, *, distance: Array, found: BoolArray, config: FrontEndConfig
) -> Matches:
    """Hold pairs of pixels against the rows, the smallest disparity and the widest angle."""
    pixels = np.column_stack([pair.rectify_left(at), pair.rectify_right(right)])
    rig = pair.rig
    off_axis = np.linalg.norm((pixels[:, :2] - [rig.cx, rig.cy]) / [rig.fx, rig.fy], axis=1)
    with np.errstate(invalid="ignore"):
        fits = (
            (np.abs(pixels[:, 1] - pixels[:, 3]) <= config.row_difference_px)
            & (pixels[:, 0] - pixels[:, 2] >= config.minimum_disparity_px)
            & (off_axis <= np.tan(np.radians(config.widest_deg)))
        )
    return Matches(right, pixels, distance, found & fits)
