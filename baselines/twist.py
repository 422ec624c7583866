"""The twist that baselines integrate: which one of a step, and that there is to be one."""

from typing import Literal

from vislam.base.errors import ConfigError
from vislam.base.types import Array
from vislam.core.estimator import Problem
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


def require_twist(problem: Problem, what: str) -> None:
    """Raise ConfigError if raw inertia is the model of motion of what is made of the twist."""
    if problem.imu is not None:
        raise ConfigError(
            f"{what}: expected motion: odometry, as it is made of the recorded velocity, got motion: imu; "
            "leave it out, or set motion to odometry"
        )
