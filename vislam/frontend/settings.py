"""What can be set of the front end."""

from typing import Annotated

from pydantic import Field
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, NonNegative, Positive, Probability, Seed


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ReadingConfig:
    """Settings of what is done with images and tracks, whichever front end makes these."""

    equalise: bool = False
    """Whether local contrast is equalised (CLAHE) first: for dark rooms, and cameras of unlike exposure."""
    row_correction: bool = True
    """Whether the right camera is turned, by less than a degree, so that rows agree in the mean; what was
    found stands in the counts."""
    fewest_observations: Annotated[int, Field(ge=1)] = 4
    """Tracks with fewer are left out."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class FrontEndConfig(ReadingConfig):
    """Settings of our front end; pixels are those of the images as they are."""

    features: Annotated[int, Field(ge=20, le=5000)] = 200
    """Tracks that are to be in view."""
    grid: tuple[Annotated[int, Field(ge=1, le=64)], Annotated[int, Field(ge=1, le=64)]] = (10, 6)
    """Columns and rows of cells over the left image, among which new corners are shared out."""
    distance_px: Positive = 12.0
    """Shortest distance between two corners [px]."""
    quality: Annotated[float, Field(gt=0, lt=1)] = 0.01
    """Smallest strength of a corner (smaller eigenvalue, Shi and Tomasi), as a share of the strongest."""
    redetect_below: Probability = 0.75
    """New corners are looked for when fewer tracks than this share of ``features`` are in view; those that
    are there go on as they are."""
    window_px: Annotated[int, Field(ge=5, le=101)] = 21
    """Width of the patch that is followed [px]; odd."""
    levels: Annotated[int, Field(ge=0, le=8)] = 3
    """Levels of the image pyramid above the image itself, where motion or disparity are not predicted."""
    predicted_levels: Annotated[int, Field(ge=0, le=8)] = 2
    """The same where both are predicted: a coarse patch holds more than the surface that the corner is on."""
    forward_backward_px: Positive = 1.5
    """Largest forward-backward error of a patch [px], both
    from frame to frame and from the left image to the right one."""
    first_forward_backward_px: Positive = 0.3
    """The same of the first stereo match of a track, which nothing else vouches for."""
    row_difference_px: Positive = 2.0
    """Largest difference of the rows of a stereo observation, in the rectified pair [px]."""
    minimum_disparity_px: NonNegative = 0.5
    """Smallest disparity of a stereo observation, in the rectified pair [px]."""
    consensus: Positive = 5.0
    """A track ends where it leaves the rigid motion of the rest by more than this, in robust standard
    deviations of the frame."""
    consensus_px: Positive = 2.0
    """It does not end by the former while it is nearer to that motion than this [px]."""
    widest_deg: Annotated[float, Field(gt=0, lt=89)] = 65.0
    """Largest angle between a ray and the axis of the rectified camera [deg]: in it, pixel noise grows with
    the square of the secant."""
    seed: Seed = 0
    """Seed of the draws of the consensus."""
