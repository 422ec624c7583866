"""A linear estimator, found by its module as anybody's own is: position by the velocity and the disparity.

Its covariance does not depend on the data, and its estimate is linear in them, so that what it is worth with
wrong parameters can be had in closed form.
"""

from dataclasses import replace

import numpy as np

from vislam.core.step import Final, Step
from vislam.core.trajectory import Poses

METRES_PER_PX = 0.02
BUILT: list = []
"""The problems it was built from, and which observations it was given."""


class LinearFilter:
    """Kalman filter of the position alone, in a world whose axes are those of the body throughout."""

    def __init__(self, problem, *, fail_above=np.inf):
        self._variance, self._fail_above = problem.noise.twist[3:] ** 2, fail_above
        self._position, self._cov = np.zeros(3), 1e-4 * np.eye(3)
        self._usable = []
        BUILT.append((problem, self._usable))

    def process(self, frame):
        if abs(frame.odometry.twist[4]) > self._fail_above:
            raise RuntimeError("too much to the left")
        stereo = frame.stereo
        self._usable.append(stereo.usable.copy())
        self._position = self._position + frame.dt * frame.odometry.twist[3:]
        self._cov = self._cov + frame.dt * np.diag(self._variance)
        # The first pose is what worlds are joined at: nothing moves it.
        if frame.k and len(stereo):
            measured = METRES_PER_PX * float(np.mean(stereo.z[:, 0] - stereo.z[:, 1]))
            gain = self._cov[:, 0] / (self._cov[0, 0] + variance_of(stereo))
            self._position = self._position + gain * (measured - self._position[0])
            self._cov = self._cov - np.outer(gain, self._cov[0])
        pose, cov = np.eye(4), 1e-8 * np.eye(6)
        pose[:3, 3], cov[3:, 3:] = self._position, self._cov
        return Step(pose, cov, used=stereo.usable)

    def finalize(self):
        return Final()


class Bare(LinearFilter):
    """The same without a covariance."""

    def process(self, frame):
        return replace(super().process(frame), pose_cov=None)


class LinearSmoother(LinearFilter):
    """The same, with poses from all data that are the causal ones moved by half of the last correction."""

    def __init__(self, problem):
        super().__init__(problem)
        self._steps = []

    def process(self, frame):
        self._steps.append(super().process(frame))
        return self._steps[-1]

    def finalize(self):
        poses = np.array([step.pose for step in self._steps])
        poses[1:, :3, 3] += 0.5 * np.diff(poses[:, :3, 3], axis=0)
        return Final(Poses(poses, np.array([step.pose_cov for step in self._steps])))


def variance_of(stereo):
    """Variance of the measured forward position [m^2]."""
    return (METRES_PER_PX * float(np.mean(stereo.sigma[:, 0]))) ** 2


def build(problem):
    return LinearFilter(problem)


def build_bare(problem):
    return Bare(problem)


def build_failing(problem):
    return LinearFilter(problem, fail_above=1.0)


def build_smoother(problem):
    return LinearSmoother(problem)
