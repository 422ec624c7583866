"""Options of the filter, and the members of its family, which are settings of them."""

from typing import Literal

from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, Positive
from vislam.estimators.ekf.chart import Coordinates
from vislam.estimators.ekf.state import ErrorForm


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class EkfOptions:
    """Options of the filter."""

    error: ErrorForm = "standard"
    """What a correction makes of the coordinates of the error: ``standard`` nothing, ``first_estimates``
    (FEJ) or ``invariant`` (right-invariant error of pose and landmarks together)."""
    landmarks: Coordinates = "point"
    """What a landmark's numbers are: a ``point`` in the world, or column, row and ``disparity`` in its first
    camera."""
    iterations: int = 1
    """Most Gauss-Newton steps of an update; more than one only with the standard error."""
    gate: bool = True
    """Refuse observations by a chi-square test of their innovation."""
    track_errors: Literal["states", "independent"] = "independent"
    """``independent``: drift and match error of the tracks are taken for white noise of the same mean
    variance, as a smoother of plain stereo factors has to. ``states``: those of each track are part of the
    state."""
    finished: Literal["smoothed", "as_left"] = "smoothed"
    """What a landmark whose track has ended is told of later data: all, by the way back over the steps, or
    nothing."""
    smoothed: bool = False
    """Let the poses, too, know what came after them."""
    observability: bool = False
    """Measure what the filter believes to learn of where the world is, which no measurement can tell; takes
    half as long again."""
    memory_mb: Positive = 1024.0
    """Memory for the way back over the steps. What does not fit is computed once more."""

    def __post_init__(self) -> None:
        """Refuse what has no meaning together."""
        if self.iterations < 1:
            raise ValueError(f"iterations must be at least 1, got {self.iterations}")
        if self.iterations > 1 and self.error != "standard":
            raise ValueError(f"iterations: only the standard error can be iterated, error is {self.error}")
        if self.smoothed and self.finished == "as_left":
            raise ValueError("smoothed poses need the way back: finished must be smoothed")
