"""Raw inertia as the smoother's model of motion: one combined factor a frame on poses, velocities and biases.

``X(k)`` is the pose, ``V(k)`` the velocity in the world, ``B(k)`` both biases. The factor is GTSAM's
``GalileanCombinedImuFactor``: its preintegration is exact for signals constant over an interval, the same as
:mod:`vislam.models.preintegration` to rounding, mean and 15 x 15 covariance. It is the combined one, with the
walk of the biases within the step: of the plain factor, for which a bias stands still over a step, the NEES
of steps of 1 s is refuted, of this one it is not (``tests/sensors/test_preintegration.py``); over a tenth of
a second there is next to no difference. The default factor differs from it by its rectangle rule.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import gtsam
import numpy as np

from vislam.base.types import Array
from vislam.core.estimator import Inertia, Problem
from vislam.core.frame import Frame
from vislam.core.imu import ImuStep
from vislam.core.step import State
from vislam.estimators.smoother.engine import Engine
from vislam.estimators.smoother.keys import B, V, X
from vislam.estimators.smoother.pixel_errors import KnownCamera
from vislam.models.imu import ACCEL_BIAS, GYRO_BIAS, VELOCITY, ImuNoise, ImuPrior

_SMALLEST_WALK = 1e-9
"""A bias that is said not to walk walks by this, as a singular covariance has no inverse [.../sqrt(s)]."""
_GTSAM_ORDER = np.r_[3:6, 0:3]
"""GTSAM has the accelerometer's bias first."""


class InertialMotion(KnownCamera):
    """Accelerometer and gyro, as one factor between two frames."""

    thresholds: Mapping[str, Array] = {"v": np.full(3, 0.05), "b": np.repeat([0.02, 0.001], 3)}

    def __init__(self, problem: Problem) -> None:
        assert problem.imu is not None
        self._inertia: Inertia = problem.imu
        self.information: Mapping[str, str] = problem.imu.information
        prior = problem.imu.prior
        self._parameters = _parameters(problem.imu.noise)
        self._velocity = np.array(prior.velocity)
        self._bias = _bias(prior)

    def factors(self, frame: Frame, before: Frame | None) -> Sequence[gtsam.NonlinearFactor]:
        """Prior of the first state, or the step; and the velocity where it is known to be zero."""
        if before is None:
            return [*_first_state(self._inertia.prior), *self._standing(frame.k)]
        return [self._step(frame), *self._standing(frame.k)]

    def _standing(self, k: int) -> list[gtsam.NonlinearFactor]:
        """Velocity of a body that stands still: its spread is the same along the axes of body and world."""
        still = self._inertia.standstill
        if still is None or not still.frames[k]:
            return []
        noise = gtsam.noiseModel.Isotropic.Sigma(3, still.sigma)
        return [gtsam.PriorFactorVector(V(k), np.zeros(3), noise)]

    def _step(self, frame: Frame) -> gtsam.NonlinearFactor:
        """Factor of the samples since the frame before."""
        k = frame.k
        step = self._preintegrated(frame)
        keys = X(k - 1), V(k - 1), X(k), V(k), B(k - 1), B(k)
        factor = gtsam.GalileanCombinedImuFactor(*keys, step)
        assert frame.imu is not None
        if frame.imu.known.all():
            return factor
        return factor.cloneWithNewNoiseModel(correlated(self._covariance(frame.imu)))

    def predict(self, frame: Frame, pose: Array) -> Array:
        """Begin with the prior's pose; then take the samples less the biases, and let gravity act."""
        if frame.k == 0:
            return np.array(self._inertia.prior.world_T_imu)
        state = gtsam.NavState(gtsam.Pose3(pose), self._velocity)
        predicted = self._preintegrated(frame).predict(state, self._bias)
        self._velocity = predicted.velocity()
        return np.asarray(predicted.pose().matrix())

    def insert(self, values: gtsam.Values, frame: Frame, pose: Array) -> None:
        """Insert pose and velocity as predicted, and the biases as known last."""
        k = frame.k
        values.insert(X(k), gtsam.Pose3(pose))
        values.insert(V(k), self._velocity)
        values.insert(B(k), self._bias)

    def keys(self, k: int) -> list[int]:
        """Keys of a frame's own variables."""
        return [X(k), V(k), B(k)]

    def tied(self, k: int) -> list[int]:
        """All of them."""
        return self.keys(k)

    def read(self, engine: Engine, frame: Frame) -> None:
        """Read velocity and biases."""
        self._velocity = engine.vector(V(frame.k))
        self._bias = engine.imu_bias(B(frame.k))

    def states(self, engine: Engine, frame: Frame, *, with_sigma: bool) -> dict[str, State]:
        """Velocity and biases as read last and, if asked for, their standard deviations."""
        k = frame.k
        value = self._velocity, self._bias.gyroscope(), self._bias.accelerometer()
        sigma: tuple[Array | None, ...] = (None, None, None)
        if with_sigma:
            of_bias = np.sqrt(np.diagonal(engine.covariance(B(k))))
            sigma = np.sqrt(np.diagonal(engine.covariance(V(k)))), of_bias[3:], of_bias[:3]
        names = VELOCITY, GYRO_BIAS, ACCEL_BIAS
        return {name: State(*both) for name, both in zip(names, zip(value, sigma, strict=True), strict=True)}

    def _preintegrated(self, frame: Frame) -> Any:
        """GTSAM's own preintegration of a step, at the biases as known last."""
        assert frame.imu is not None
        found = gtsam.PreintegratedCombinedMeasurementsG(self._parameters, self._bias)
        step = frame.imu
        for accel, gyro, dt in zip(step.mean_accel, step.mean_gyro, step.dt.tolist(), strict=True):
            found.integrateMeasurement(accel, gyro, dt)
        return found

    def _covariance(self, step: ImuStep) -> Array:
        """Covariance ``(15, 15)`` of GTSAM's residual over a step that samples do not cover whole.

        Its residual, what is predicted less what is, has position and velocity in the last body and the
        accelerometer's bias in front of the gyro's.
        """
        biases = self._bias.gyroscope(), self._bias.accelerometer()
        found = step.preintegrated(self._inertia.noise, *biases)
        turn = np.zeros((15, 15))
        turn[:3, :3] = np.eye(3)
        turn[3:6, 3:6] = turn[6:9, 6:9] = found.rotation.T
        turn[9:, 9:][:, _GTSAM_ORDER] = np.eye(6)
        cov = found.cov.copy()
        cov[9:, 9:] += np.sum(step.dt) * _SMALLEST_WALK**2 * np.eye(6)
        return np.asarray(turn @ cov @ turn.T)


def _parameters(noise: ImuNoise) -> gtsam.PreintegrationCombinedParams:
    """GTSAM's parameters of the noise; an exact step needs no integration noise."""
    found = gtsam.PreintegrationCombinedParams.MakeSharedU(noise.gravity)
    found.setIntegrationCovariance(np.zeros((3, 3)))
    found.setGyroscopeCovariance(noise.gyro_density**2 * np.eye(3))
    found.setAccelerometerCovariance(noise.accel_density**2 * np.eye(3))
    found.setBiasOmegaCovariance(max(noise.gyro_walk, _SMALLEST_WALK) ** 2 * np.eye(3))
    found.setBiasAccCovariance(max(noise.accel_walk, _SMALLEST_WALK) ** 2 * np.eye(3))
    return found


def _bias(prior: ImuPrior) -> gtsam.imuBias.ConstantBias:
    return gtsam.imuBias.ConstantBias(prior.accel_bias, prior.gyro_bias)


def correlated(cov: Array) -> gtsam.noiseModel.Base:
    """Noise of a covariance, whole: by default GTSAM takes one for diagonal if it is so within 1e-9.

    That is in whatever units they are, and 1e-9 rad^2 are 30 microradians squared.
    """
    return gtsam.noiseModel.Gaussian.Covariance(cov, False)


def _first_state(prior: ImuPrior) -> list[gtsam.NonlinearFactor]:
    """Prior of pose, velocity and biases at the first frame: a factor each, or one if they are correlated."""
    key: dict[int, Any] = {
        X(0): gtsam.Pose3(prior.world_T_imu),
        V(0): np.array(prior.velocity),
        B(0): _bias(prior),
    }
    order = np.r_[0:9, 9 + _GTSAM_ORDER]
    cov = prior.cov[np.ix_(order, order)]
    parts = [slice(0, 6), slice(6, 9), slice(9, 15)]
    apart = np.zeros_like(cov)
    for part in parts:
        apart[part, part] = cov[part, part]
    if np.array_equal(apart, cov):
        kinds = gtsam.PriorFactorPose3, gtsam.PriorFactorVector, gtsam.PriorFactorConstantBias
        return [
            kind(name, mean, correlated(cov[part, part]))
            for kind, (name, mean), part in zip(kinds, key.items(), parts, strict=True)
        ]
    # Linear in the local coordinates of the prior's mean.
    values, root = gtsam.Values(), np.linalg.inv(np.linalg.cholesky(cov))
    for name, mean in key.items():
        values.insert(name, mean)
    blocks = [item for name, part in zip(key, parts, strict=True) for item in (name, root[:, part])]
    linear: Any = gtsam.JacobianFactor
    unit = gtsam.noiseModel.Unit.Create(15)
    return [gtsam.LinearContainerFactor(linear(*blocks, np.zeros(15), unit), values)]
