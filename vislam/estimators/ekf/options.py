"""Options of the filter; its variants are settings of them."""

from typing import Literal

from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, Positive
from vislam.estimators.ekf.parametrisation import ParametrisationName
from vislam.estimators.ekf.state import ErrorForm


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class EkfOptions:
    """Options of the filter."""

    error: ErrorForm = "standard"
    """Form of the error state: ``standard`` (additive), ``fej`` (first-estimates Jacobians) or ``invariant``
    (right-invariant error of pose and landmarks together)."""
    landmarks: ParametrisationName = "point"
    """Parametrisation of a landmark: a ``point`` in the world, or ``anchored_uvd``, its column, row and
    disparity in the camera of its first observation (the anchor)."""
    iterations: int = 1
    """Gauss-Newton iterations of an update, at most; more than one only with the standard error."""
    gate: bool = True
    """Reject observations by a chi-square test of their innovation."""
    track_errors: Literal["states", "independent"] = "independent"
    """``independent``: tracker drift and stereo-matching bias are approximated by white noise of the same
    mean variance, as in a smoother of plain stereo factors. ``states``: those of each track are part of the
    state."""
    marginalised_landmarks: Literal["smoothed", "filtered"] = "smoothed"
    """Estimate that the map has of a landmark whose track has ended and that was marginalised: ``smoothed``,
    by the backward pass, or ``filtered``, as it was then."""
    smoothed: bool = False
    """Smooth the poses as well (fixed-interval smoothing)."""
    observability: bool = False
    """Measure the spurious information that the filter gains along the unobservable directions; takes half as
    long again."""
    memory_mb: Positive = 512.0
    """Memory of the backward pass. What does not fit is computed once more."""

    def __post_init__(self) -> None:
        """Reject options that contradict each other."""
        if self.iterations < 1:
            raise ValueError(f"iterations must be at least 1, got {self.iterations}")
        if self.iterations > 1 and self.error != "standard":
            raise ValueError(f"iterations: only the standard error can be iterated, error is {self.error}")
        if self.smoothed and self.marginalised_landmarks == "filtered":
            raise ValueError("smoothed poses need the backward pass: marginalised_landmarks must be smoothed")
