"""Repairs of the inertial samples: their clock, and what their third velocity component is."""

from dataclasses import replace

from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT
from vislam.core.sequence import Sequence


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Clock:
    """Move the inertial stamps to the camera's clock."""

    offset: float
    """How late the inertial stamps are against the camera's [s]."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Move them."""
        return replace(sequence, clock_offset=self.offset)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class NavigationFrameVelocity:
    """Take the third velocity component for what it is in a levelled recording, the vertical velocity."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Set the body's own vertical velocity to 0: a car does not move along its own z."""
        twist = sequence.twist.copy()
        vertical_velocity = twist[:, 5].copy()
        twist[:, 5] = 0.0
        return replace(sequence, twist=twist, vertical_velocity=vertical_velocity)
