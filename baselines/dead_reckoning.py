"""Dead reckoning (course report, section III-A): the inertial data integrated, with their covariance."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass

from vislam.base import settings
from vislam.base.fields import STRICT
from vislam.comparison.config import Six
from vislam.core.estimator import Problem
from vislam.core.frame import Frame
from vislam.core.step import TWIST_BIAS, Final, State, Step
from vislam.estimators.ekf.layout import NavLayout
from vislam.estimators.ekf.motion import Measurement, OdometryMotion
from vislam.geometry import se3
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
    """Integrates the twist less the prior mean of its bias (eqs. 23 to 25), and follows the climb rate.

    Where the vertical velocity is in use (``noise.climb``) it is a measurement of the height, as it is for
    every other estimator: a Kalman filter whose state is pose, bias, tilt and integrated climb. Without it
    nothing is measured, and the mean is the integral.
    """

    blind = True

    def __init__(self, problem: Problem, options: DeadReckoningOptions) -> None:
        self._options = options
        self._motion = OdometryMotion(problem)
        blocks = self._motion.blocks()
        self._layout = NavLayout({name: len(block.mean) for name, block in blocks.items()})
        self._nav = np.concatenate([np.zeros(6), *(block.mean for block in blocks.values())])
        sigma = np.concatenate([problem.first_pose_sigma, *(block.sigma for block in blocks.values())])
        self._world_T_imu, self._cov = np.eye(4), np.diag(sigma**2)
        if options.motion_variance is not None:
            self._cov[BIAS, BIAS] = 0.0

    def process(self, frame: Frame) -> Step:
        """Take one frame; its observations are not looked at."""
        if frame.k > 0:
            self._predict(frame)
        for found in self._motion.measurements(self._layout, self._world_T_imu, self._nav, frame):
            self._update(found)
        bias = State(self._nav[BIAS].copy())
        return Step(self._world_T_imu, self._cov[POSE, POSE].copy(), states={TWIST_BIAS: bias})

    def finalize(self) -> Final:
        """Leave the poses as they were; there is no map."""
        return Final(up=self._motion.up(self._layout, self._nav))

    def _predict(self, frame: Frame) -> None:
        options = self._options
        held = replace(frame.odometry, twist=step_twist(frame, options.integration))
        step = self._motion.propagate(self._layout, self._nav, replace(frame, odometry=held))
        noise = step.noise
        if options.motion_variance is not None:
            noise = noise.copy()
            noise[POSE, POSE], noise[BIAS, BIAS] = np.diag(options.motion_variance), 0.0
        self._world_T_imu = self._world_T_imu @ step.prev_T_next
        self._nav = self._nav + step.change
        self._cov = step.transition @ self._cov @ step.transition.T + noise

    def _update(self, found: Measurement) -> None:
        """Kalman update, in Joseph's form."""
        spread = found.by_nav @ self._cov @ found.by_nav.T + np.diag(found.variance)
        gain = np.linalg.solve(spread, found.by_nav @ self._cov).T
        correction, kept = gain @ found.innovation, np.eye(len(self._cov)) - gain @ found.by_nav
        self._world_T_imu = se3.retract(self._world_T_imu, correction[POSE])
        self._nav = self._nav + correction
        self._cov = kept @ self._cov @ kept.T + (gain * found.variance) @ gain.T
