"""The one builder of factors: every smoother poses the same problem, and it is the filter's."""

from typing import Any

import gtsam
import numpy as np

from vislam.estimator import Problem
from vislam.geometry import se3
from vislam.motion import integrate
from vislam.smoother.keys import B, X
from vislam.types import Array


class FactorBuilder:
    """Factors of a :class:`Problem`, in the project's tangent order, which is GTSAM's."""

    def __init__(self, problem: Problem, *, huber: float | None) -> None:
        rig = problem.rig
        self._problem = problem
        self._calibration = gtsam.Cal3_S2Stereo(rig.fx, rig.fy, 0.0, rig.cx, rig.cy, rig.baseline)
        self._body_P_sensor = gtsam.Pose3(rig.imu_T_cam)
        self._kernel = None if huber is None else gtsam.noiseModel.mEstimator.Huber.Create(huber)

    def priors(self) -> list[gtsam.NonlinearFactor]:
        """Priors of the first pose and the first bias."""
        problem = self._problem
        pose = gtsam.noiseModel.Diagonal.Sigmas(problem.first_pose_sigma)
        bias = gtsam.noiseModel.Diagonal.Sigmas(problem.bias_sigma)
        return [
            gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), pose),
            gtsam.PriorFactorVector(B(0), problem.bias_mean, bias),
        ]

    def motion(self, k: int, *, twist: Array, bias: Array, dt: float) -> list[gtsam.NonlinearFactor]:
        """Between-factors from frame k - 1 to k: the pose by the twist less its bias, and the bias walk.

        The noise of the pose factor is that of the filter's prediction, at the current bias.
        """
        step = integrate(twist, bias=bias, dt=dt, noise=self._problem.noise)
        walk = gtsam.noiseModel.Gaussian.Covariance(step.bias_cov)
        return [
            twist_factor(X(k - 1), B(k - 1), X(k), twist=twist, dt=dt, cov=step.cov),
            gtsam.BetweenFactorVector(B(k - 1), B(k), np.zeros(6), walk),
        ]

    def stereo(self, k: int, key: int, *, z: Array, sigma: Array) -> gtsam.NonlinearFactor:
        """Stereo factor of a landmark seen from frame k as ``z (3,)`` = (uL, uR, v), ``sigma (3,)`` [px]."""
        return gtsam.GenericStereoFactor3D(
            gtsam.StereoPoint2(*z), self._noise(sigma), X(k), key, self._calibration, self._body_P_sensor
        )

    def _noise(self, sigma: Array) -> gtsam.noiseModel.Base:
        noise: gtsam.noiseModel.Base = gtsam.noiseModel.Diagonal.Sigmas(sigma)
        return noise if self._kernel is None else gtsam.noiseModel.Robust.Create(self._kernel, noise)


def twist_factor(
    before: int, bias: int, after: int, *, twist: Array, dt: float, cov: Array
) -> gtsam.CustomFactor:
    """Pose between-factor whose measurement is an inertial twist less the bias variable.

    The error is ``log(exp(dt (u - b))^-1 T_before^-1 T_after)``; with J the right Jacobian, E the
    argument of the log and A the relative pose, its derivatives are ``-J^-1(e) Ad(A^-1)``,
    ``J^-1(e) Ad(E^-1) J(dt (u - b)) dt`` and ``J^-1(e)``.

    Parameters
    ----------
    before, bias, after : int
        Keys of the two poses and of the bias.
    twist : (6,)
        Mean inertial twist (omega, v) over the step [rad/s, m/s].
    dt : float
        Length of the step [s].
    cov : (6, 6)
        Covariance of the step, on its right.
    """

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Any] | None) -> Array:
        xi = dt * (twist - values.atVector(bias))
        relative = values.atPose3(before).between(values.atPose3(after)).matrix()
        mismatch = se3.inverse(se3.exp(xi)) @ relative
        residual = se3.log(mismatch)
        if jacobians is not None:
            by_after = np.linalg.inv(se3.right_jacobian(residual))
            jacobians[0] = -by_after @ se3.adjoint(se3.inverse(relative))
            jacobians[1] = by_after @ se3.adjoint(se3.inverse(mismatch)) @ se3.right_jacobian(xi) * dt
            jacobians[2] = by_after
        return residual

    return gtsam.CustomFactor(gtsam.noiseModel.Gaussian.Covariance(cov), [before, bias, after], error)
