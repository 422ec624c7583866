"""Dead reckoning (report, section III-A): the inertial twist integrated, with its covariance, no camera."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass

from vislam import config, motion
from vislam.data import Frame
from vislam.estimator import Estimate, Problem, StepRecord
from vislam.fields import STRICT
from vislam.motion import POSE
from vislam.types import Array, BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DeadReckoningOptions:
    """Dead reckoning has no options."""


def build(problem: Problem, options: Mapping[str, Any]) -> "DeadReckoning":
    """Build dead reckoning from a problem."""
    config.parse(DeadReckoningOptions, dict(options), at="estimators.dead_reckoning")
    return DeadReckoning(problem)


class DeadReckoning:
    """Integrates the twist less the prior mean of its bias (eqs. 23 to 25)."""

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._world_T_imu = np.eye(4)
        self._cov = np.diag(np.concatenate([problem.first_pose_sigma, problem.bias_sigma]) ** 2)
        self._poses: list[Array] = []

    def process(self, frame: Frame, refused: BoolArray) -> StepRecord:
        """Take one frame; its observations are not looked at."""
        problem = self._problem
        if frame.k > 0:
            step = motion.integrate(frame.twist, bias=problem.bias_mean, dt=frame.dt, noise=problem.noise)
            transition, noise = motion.transition(step)
            self._world_T_imu = self._world_T_imu @ step.prev_T_next
            self._cov = transition @ self._cov @ transition.T + noise
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
