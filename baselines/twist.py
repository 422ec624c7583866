"""Which twist of a step is integrated: what the baselines can take in place of the step's mean."""

from typing import Literal

from vislam.base.types import Array
from vislam.core.frame import Frame

Integration = Literal["mean", "first"]
"""``mean``: the mean over the step. ``first``: the value at its start, as in the report's eq. (23)."""


def step_twist(frame: Frame, integration: Integration) -> Array:
    """Twist ``(6,)`` that is held over the step into a frame [rad/s, m/s].

    The first one is exact where the samples lie at the frames, as straight lines join them.
    """
    return (
        frame.odometry.twist
        if integration == "mean"
        else frame.odometry.twist - 0.5 * frame.odometry.twist_change
    )
