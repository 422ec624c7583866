"""Dead reckoning (report, section III-A): the inertial twist integrated, with its covariance, no camera."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass

from vislam.base import settings
from vislam.base.fields import STRICT
from vislam.base.types import Array, BoolArray
from vislam.comparison.config import Six
from vislam.core.estimator import Estimate, Problem, StepRecord
from vislam.core.sequence import Frame
from vislam.models import odometry as motion
from vislam.models.odometry import BIAS, POSE
from vislam_baselines.twist import Integration, step_twist


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DeadReckoningOptions:
    """Options of dead reckoning."""

    integration: Integration = "mean"
    """Which twist is held over a step."""
    motion_variance: Six | None = None
    """Variance (omega, v) that a step adds whatever its length, as W of the report's eq. (25) [rad^2, m^2];
    the bias is then held to be known. null: the noise of the comparison."""


def build(problem: Problem, options: Mapping[str, Any]) -> "DeadReckoning":
    """Build dead reckoning from a problem and the options of its config section."""
    parsed = settings.parse(DeadReckoningOptions, dict(options), at="estimators.dead_reckoning")
    return DeadReckoning(problem, parsed)


class DeadReckoning:
    """Integrates the twist less the prior mean of its bias (eqs. 23 to 25)."""

    blind = True

    def __init__(self, problem: Problem, options: DeadReckoningOptions) -> None:
        self._problem = problem
        self._options = options
        self._world_T_imu = np.eye(4)
        self._cov = np.diag(np.concatenate([problem.first_pose_sigma, problem.bias_sigma]) ** 2)
        if options.motion_variance is not None:
            self._cov[BIAS, BIAS] = 0.0
        self._poses: list[Array] = []

    def process(self, frame: Frame, refused: BoolArray) -> StepRecord:
        """Take one frame; its observations are not looked at."""
        problem = self._problem
        if frame.k > 0:
            self._predict(frame)
        self._poses.append(self._world_T_imu)
        nothing = np.zeros(len(frame.track), bool)
        return StepRecord(
            world_T_imu=self._world_T_imu,
            pose_cov=self._cov[POSE, POSE].copy(),
            bias=problem.bias_mean,
            bias_sigma=None,
            nis=0.0,
            dof=0,
            log_likelihood=float("nan"),
            used=nothing,
            gated=nothing,
        )

    def finalize(self) -> Estimate:
        """Return the poses; there is no map."""
        return Estimate(np.array(self._poses), None, np.empty(0, np.int64), np.empty((0, 3)), None, {})

    def _predict(self, frame: Frame) -> None:
        problem, options = self._problem, self._options
        twist = step_twist(frame, options.integration)
        step = motion.integrate(twist, bias=problem.bias_mean, dt=frame.dt, noise=problem.noise)
        transition, noise = motion.transition(step)
        if options.motion_variance is not None:
            noise = np.diag([*options.motion_variance, *np.zeros(6)])
        self._world_T_imu = self._world_T_imu @ step.prev_T_next
        self._cov = transition @ self._cov @ transition.T + noise
