"""Dead reckoning (course report, section III-A): the twist integrated, with its covariance."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass

from vislam.base import settings
from vislam.base.fields import STRICT
from vislam.base.types import Array
from vislam.comparison.config import Six
from vislam.core.estimator import UNKNOWN_VERTICAL_VELOCITY, Problem
from vislam.core.frame import Frame
from vislam.core.step import TWIST_BIAS, Final, State, Step
from vislam.models import odometry as motion
from vislam.models.odometry import BIAS, POSE
from vislam_baselines.inertial_reckoning import InertialReckoning
from vislam_baselines.twist import Integration, require_twist, step_twist


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DeadReckoningOptions:
    """Options of dead reckoning."""

    integration: Integration = "mean"
    """Which twist is held over a step."""
    motion_variance: Six | None = None
    """Variance (omega, v) that a step adds whatever its length, as W of the course report's eq. (25) [rad^2,
    m^2]; the bias is then held to be known. null: the noise of the comparison."""


def build(problem: Problem, options: Mapping[str, Any]) -> "DeadReckoning | InertialReckoning":
    """Build dead reckoning, by raw inertia where that is the model of motion; options are of the twist."""
    parsed = settings.parse(DeadReckoningOptions, dict(options), at="estimators.dead_reckoning")
    if problem.imu is None:
        return DeadReckoning(problem, parsed)
    for name in options:
        require_twist(problem, f"estimators.dead_reckoning.{name}")
    return InertialReckoning(problem)


class DeadReckoning:
    """Integrates the twist less the prior mean of its bias on SE(3), and the vertical velocity.

    The course report's eqs. 23 to 25.

    Where the vertical velocity is in use (``noise.vertical_velocity``) the height is its integral, and the
    twist has no say in it; nothing is fused. The height's variance is that of the walk of the integral and of
    the tilt of the first pose over the distance from the start.
    """

    blind = True

    def __init__(self, problem: Problem, options: DeadReckoningOptions) -> None:
        self._problem = problem
        self._options = options
        self._world_T_imu = np.eye(4)
        self._cov = np.diag(np.concatenate([problem.first_pose_sigma, problem.bias_sigma]) ** 2)
        self._height = self._height_variance = 0.0
        if options.motion_variance is not None:
            self._cov[BIAS, BIAS] = 0.0

    def process(self, frame: Frame) -> Step:
        """Take one frame; its observations are not looked at."""
        if frame.k > 0:
            self._predict(frame)
        bias = State(self._problem.bias_mean)
        return Step(*self._with_height(), states={TWIST_BIAS: bias})

    def finalize(self) -> Final:
        """Leave the poses as they were; there is no map."""
        return Final()

    def _predict(self, frame: Frame) -> None:
        problem, options = self._problem, self._options
        twist = step_twist(frame, options.integration)
        step = motion.integrate(twist, bias=problem.bias_mean, dt=frame.dt, noise=problem.noise)
        transition, noise = motion.transition(step)
        if options.motion_variance is not None:
            noise = np.diag([*options.motion_variance, *np.zeros(6)])
        self._world_T_imu = self._world_T_imu @ step.prev_T_next
        self._cov = transition @ self._cov @ transition.T + noise
        rise = problem.vertical_velocity
        if rise is not None:
            known = np.isfinite(frame.odometry.vertical_velocity)
            self._height += frame.dt * frame.odometry.vertical_velocity if known else 0.0
            self._height_variance += (
                frame.dt * rise.walk**2 if known else (frame.dt * UNKNOWN_VERTICAL_VELOCITY) ** 2
            )

    def _with_height(self) -> tuple[Array, Array]:
        """Pose and covariance, on its right, with the height as the vertical velocity has led."""
        pose, cov, rise = self._world_T_imu, self._cov[POSE, POSE].copy(), self._problem.vertical_velocity
        if rise is None:
            return pose, cov
        pose = pose.copy()
        pose[2, 3] = self._height
        turn = np.eye(6)
        turn[3:, 3:] = pose[:3, :3]
        cov = turn @ cov @ turn.T
        variance = self._height_variance + rise.tilt_sigma**2 * float(pose[:2, 3] @ pose[:2, 3])
        cov[5], cov[:, 5] = 0.0, 0.0
        cov[5, 5] = max(variance, float(self._problem.first_pose_sigma[5]) ** 2)
        return pose, turn.T @ cov @ turn
