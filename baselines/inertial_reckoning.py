"""Dead reckoning by accelerometer and gyro: preintegrated steps in sequence, with their covariance."""

import numpy as np

from vislam.core.estimator import Problem
from vislam.core.frame import Frame
from vislam.core.step import Final, Step
from vislam.estimators.ekf.inertial import InertialMotion
from vislam.estimators.ekf.motion import navigation
from vislam.estimators.ekf.propagation import reported
from vislam.models.odometry import POSE


class InertialReckoning:
    """Predicts pose, velocity and biases from the prior of the first state, and corrects nothing.

    It is the prediction of the filters (:mod:`vislam.estimators.ekf.inertial`), so that the camera is all
    that separates them. An error of the gyro's bias moves the position by the third power of time, one of the
    accelerometer's or of the tilt by the square.
    """

    blind = True
    upright = True

    def __init__(self, problem: Problem) -> None:
        self._motion = InertialMotion(problem)
        first = navigation(problem, self._motion)
        self._layout = first.layout
        self._world_T_imu, self._nav, self._cov = first.world_T_imu, first.nav, first.cov

    def process(self, frame: Frame) -> Step:
        """Take one frame; its observations are not looked at."""
        if frame.k > 0:
            step = self._motion.propagate(self._layout, self._world_T_imu, self._nav, frame)
            self._world_T_imu = self._world_T_imu @ step.prev_T_next
            self._nav = self._nav + step.change
            self._cov = step.transition @ self._cov @ step.transition.T + step.noise
        states = reported(self._motion, self._layout, self._nav, self._cov)
        return Step(self._world_T_imu, np.array(self._cov[POSE, POSE]), states=states)

    def finalize(self) -> Final:
        """Leave the poses as they were; there is no map."""
        return Final()
