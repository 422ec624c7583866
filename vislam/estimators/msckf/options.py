"""Options of the multi-state constraint Kalman filter."""

from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT

ErrorForm = Literal["standard", "fej", "invariant"]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class MsckfOptions:
    """Options of the multi-state constraint Kalman filter."""

    error: ErrorForm = "fej"
    """Where Jacobians are evaluated: ``standard`` at the current estimates, ``fej`` (FEJ) at the
    first estimate of each pose, or ``invariant`` at the current estimates, in coordinates of the error that
    keep their meaning as a rigid motion of the world."""
    window: Annotated[int, Field(ge=1)] = 20
    """Past poses (clones) in the state, the current one not counted."""
    min_length: Annotated[int, Field(ge=2)] = 2
    """A track with fewer observations is not fused: a single one says nothing of the pose."""
    max_length: Annotated[int, Field(ge=2)] | None = None
    """A track with as many observations is fused, and goes on as another; null: as many as the window
    holds."""
    gate: bool = True
    """Reject tracks by a chi-square test of their projected residual."""

    def __post_init__(self) -> None:
        """Reject lengths that no track can have."""
        if self.min_length > self.window + 1:
            raise ValueError(
                f"min_length must be at most window + 1 = {self.window + 1}, got {self.min_length}"
            )
        if self.max_length is not None and self.max_length < self.min_length:
            raise ValueError(
                f"max_length must be at least min_length, {self.min_length}, got {self.max_length}"
            )
