"""Models of motion as the smoother takes them: factors between frames, their variables and first values.

All factors are GTSAM's own. A factor written in Python is handed a copy of all values each time it is
linearised, so that a step would take the longer the longer the drive already is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Protocol

import gtsam
import gtsam_unstable
import numpy as np

from vislam.base.types import Array
from vislam.core.estimator import (
    FIRST_TWIST_S,
    HEIGHT_SIGMA,
    UNKNOWN_VERTICAL_VELOCITY,
    Problem,
    VerticalVelocityNoise,
)
from vislam.core.frame import Frame
from vislam.core.step import TWIST_BIAS, State
from vislam.estimators.smoother.engine import Engine
from vislam.estimators.smoother.inertial import InertialMotion
from vislam.estimators.smoother.keys import CLOCK, DIRECTION, LINEAR, B, H, V, W, X
from vislam.geometry import se3
from vislam.models import odometry

_UNUSED = 1.0
"""Spread of the two coordinates of a height's point that no factor asks for [m]."""
_SMALLEST_DENSITY = 1e-9


class Motion(Protocol):
    """A model of motion, and what it has read of its own variables so far."""

    def factors(self, frame: Frame, before: Frame | None) -> Sequence[gtsam.NonlinearFactor]:
        """All factors of a frame but those of its tracks; ``before`` is None for the first frame."""
        ...

    def predict(self, frame: Frame, pose: Array) -> Array:
        """Predict the pose ``(4, 4)`` at a frame from that at the frame before, by what was read last."""
        ...

    def insert(self, values: gtsam.Values, frame: Frame, pose: Array) -> None:
        """Give the variables of a frame their first values, after it was predicted."""
        ...

    def keys(self, k: int) -> list[int]:
        """Keys of a frame's own variables."""
        ...

    def tied(self, k: int) -> list[int]:
        """Keys that the factors of the next frame tie to."""
        ...

    def read(self, engine: Engine, frame: Frame) -> None:
        """Read the variables of the newest frame."""
        ...

    def states(self, engine: Engine, frame: Frame, *, with_sigma: bool) -> dict[str, State]:
        """What is estimated beside the pose, as read last and, if asked for, with standard deviations."""
        ...

    @property
    def information(self) -> Mapping[str, str]:
        """What an estimator says of it beside others."""
        ...

    @property
    def thresholds(self) -> Mapping[str, Array]:
        """Changes of its variables, by the letter of their keys, from which on these are relinearised."""
        ...


class Height:
    """The vertical velocity as a measurement of the height ``H(k)``, which is its z, where it is in use.

    The world's z axis is up then, and the first pose is free to be tilted.
    """

    def __init__(self, noise: VerticalVelocityNoise | None) -> None:
        self._noise = noise
        self._height = 0.0

    def first_pose_sigma(self, sigma: Array) -> Array:
        """Spread ``(6,)`` of the first pose: that of the prior, and of its tilt."""
        sigma = np.array(sigma)
        if self._noise is not None:
            sigma[:2] = np.hypot(sigma[:2], self._noise.tilt_sigma)
        return sigma

    def factors(self, frame: Frame) -> list[gtsam.NonlinearFactor]:
        """The height's prior or its rise over the step, and that the pose is there."""
        if self._noise is None:
            return []
        k = frame.k
        if k == 0:
            rise: gtsam.NonlinearFactor = gtsam.PriorFactorPoint3(
                H(0), np.zeros(3), _sigmas([_UNUSED, _UNUSED, 1e-4])
            )
        else:
            known = np.isfinite(frame.odometry.vertical_velocity)
            spread = np.sqrt(frame.dt) * self._noise.walk if known else frame.dt * UNKNOWN_VERTICAL_VELOCITY
            by = np.array([0.0, 0.0, frame.dt * frame.odometry.vertical_velocity if known else 0.0])
            rise = gtsam.BetweenFactorPoint3(H(k - 1), H(k), by, _sigmas([_UNUSED, _UNUSED, spread]))
        return [rise, gtsam_unstable.RelativeElevationFactor(X(k), H(k), 0.0, _sigmas([HEIGHT_SIGMA]))]

    def predict(self, frame: Frame) -> None:
        """Integrate the vertical velocity."""
        if np.isfinite(frame.odometry.vertical_velocity):
            self._height += frame.dt * frame.odometry.vertical_velocity

    def insert(self, values: gtsam.Values, k: int) -> None:
        """Insert the height as predicted."""
        if self._noise is not None:
            values.insert(H(k), np.array([0.0, 0.0, self._height]))

    def keys(self, k: int) -> list[int]:
        """Key of the height, where it is in use."""
        return [] if self._noise is None else [H(k)]


class OdometryMotion:
    """The recorded twist less its bias, its clock, and the vertical velocity, in the project's tangent order.

    The motion over a step is ``log(T_{k-1}^-1 T_k) = dt w_k + n`` with w the inertial twist less its bias and
    n of covariance ``dt diag(density^2)``: :func:`vislam.models.odometry.integrate` with the noise told on
    the twist. GTSAM has it as a part of its white-noise-on-acceleration prior (Anderson and Barfoot, IROS
    2015), between a pose and a twist before and after. Its twist after the step is here a variable of its
    own, ``V(k)``, in no other factor: it takes up the other half of the error whatever that is, and of the
    first half, whose covariance is ``dt^3 / 3 Qc``, nothing is lost.

    As w is the variable and not the bias, the walk of the bias is ``w_{k+1} - w_k = u_{k+1} - u_k + n``. What
    is constant all along, the clock and the direction of the velocity in the body, stands in the prior of the
    bias and in its walk, linearly.

    The vertical velocity enters by :class:`Height`; without it the first pose is the identity within its
    prior.
    """

    information: Mapping[str, str] = {"twist bias": "estimated"}
    thresholds: Mapping[str, Array] = LINEAR

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._constants = _constants(problem)
        self._bias = np.array(problem.bias_mean)
        self._twist = np.zeros(6)
        self._known = {key: np.zeros(len(sigma)) for key, sigma in self._constants.items()}
        self._height = Height(problem.vertical_velocity)

    def factors(self, frame: Frame, before: Frame | None) -> list[gtsam.NonlinearFactor]:
        """Priors, motion, walk of the bias, vertical velocity."""
        k, problem = frame.k, self._problem
        if before is None:
            return [_first_pose(problem, self._height), *self._height.factors(frame)]
        end = gtsam.StateData(X(k), V(k), frame.dt)
        density = np.maximum(problem.noise.twist, _SMALLEST_DENSITY)
        return [
            gtsam.WnoaMotionFactorPose3(
                gtsam.StateData(X(k - 1), W(k), 0.0), end, 3.0 * (density / frame.dt) ** 2
            ),
            *self._bias_factors(frame, before),
            *self._height.factors(frame),
        ]

    def predict(self, frame: Frame, pose: Array) -> Array:
        """Integrate the twist less its bias, and the vertical velocity."""
        if frame.k == 0:
            return pose
        self._twist = self._recorded(frame) - self._bias
        self._height.predict(frame)
        return pose @ se3.exp(frame.dt * self._twist)

    def insert(self, values: gtsam.Values, frame: Frame, pose: Array) -> None:
        """Insert pose, twist, constants and height as predicted."""
        k = frame.k
        values.insert(X(k), gtsam.Pose3(pose))
        if k > 0:
            values.insert(W(k), self._twist)
            values.insert(V(k), self._twist)
        if k == 1:
            for key, value in self._known.items():
                values.insert(key, value)
        self._height.insert(values, k)

    def keys(self, k: int) -> list[int]:
        """Keys of a frame's own variables."""
        return [X(k), *([W(k), V(k)] if k > 0 else []), *self._height.keys(k)]

    def tied(self, k: int) -> list[int]:
        """Keys that the factors of the next frame tie to."""
        constants = self._constants if k > 0 else ()
        return [*(key for key in self.keys(k) if key != V(k)), *constants]

    def read(self, engine: Engine, frame: Frame) -> None:
        """Read constants and bias."""
        if frame.k > 0:
            self._known = {key: engine.vector(key) for key in self._constants}
            self._bias = self._recorded(frame) - engine.vector(W(frame.k))

    def states(self, engine: Engine, frame: Frame, *, with_sigma: bool) -> dict[str, State]:
        """Bias at the end of the step; the constants' share in the variance of the twist is left in it."""
        sigma = None
        if with_sigma and frame.k == 0:
            sigma = np.array(self._problem.bias_sigma)
        elif with_sigma:
            walk = frame.dt * self._problem.noise.bias_walk**2
            sigma = np.sqrt(np.diagonal(engine.covariance(W(frame.k))) + walk)
        return {TWIST_BIAS: State(self._bias, sigma)}

    def _bias_factors(self, frame: Frame, before: Frame) -> list[gtsam.NonlinearFactor]:
        """Ties of the twist less its bias: the prior of the bias at the first step, its walk after that."""
        problem, key, constants = self._problem, W(frame.k), self._design(frame)
        if before.k == 0:
            mean, sigma = frame.odometry.twist - problem.bias_mean, np.asarray(problem.bias_sigma)
            if not constants:
                return [gtsam.PriorFactorVector(key, mean, _sigmas(sigma))]
            priors = [
                gtsam.PriorFactorVector(constant, np.zeros(len(spread)), _sigmas(spread))
                for constant, spread in self._constants.items()
            ]
            terms = {constant: -matrix for constant, matrix in constants.items()}
            return [*priors, _linear({key: np.eye(6), **terms}, mean, sigma)]
        change = frame.odometry.twist - before.odometry.twist
        sigma = np.sqrt(before.dt) * problem.noise.bias_walk
        if not constants:
            return [gtsam.BetweenFactorVector(W(before.k), key, change, _sigmas(sigma))]
        terms = {constant: matrix - constants[constant] for constant, matrix in self._design(before).items()}
        return [_linear({W(before.k): -np.eye(6), key: np.eye(6), **terms}, change, sigma)]

    def _design(self, frame: Frame) -> dict[int, Array]:
        """What the recorded twist of a step rises by with each constant, by its key."""
        odometry_step = frame.odometry
        every = {
            CLOCK: odometry_step.twist_change[:, None] / frame.dt,
            DIRECTION: -odometry_step.twist[3] * odometry.ACROSS,
        }
        return {key: every[key] for key in self._constants}

    def _recorded(self, frame: Frame) -> Array:
        """Recorded twist ``(6,)`` of a step with the constants as read last."""
        return np.asarray(
            frame.odometry.twist
            + sum(matrix @ self._known[key] for key, matrix in self._design(frame).items())
        )


class SmoothMotion(OdometryMotion):
    """The same, of a body that moves smoothly: white noise on its acceleration is all that changes its twist.

    To the factors of the recorded twist comes GTSAM's white-noise-on-acceleration prior (Anderson and
    Barfoot, IROS 2015) between poses and the body's own twists ``B(k)`` at the frames, of the first of which
    next to nothing is known but the first inertial sample.
    """

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        assert problem.noise.acceleration is not None
        self._acceleration = problem.noise.acceleration

    def factors(self, frame: Frame, before: Frame | None) -> list[gtsam.NonlinearFactor]:
        """Those of the recorded twist, and the prior of smooth motion."""
        k, found = frame.k, super().factors(frame, before)
        if before is None:
            mean = frame.odometry.twist - self._problem.bias_mean
            sigma = np.sqrt(FIRST_TWIST_S) * self._acceleration
            return [*found, gtsam.PriorFactorVector(B(0), mean, _sigmas(sigma))]
        ends = gtsam.StateData(X(k - 1), B(k - 1), 0.0), gtsam.StateData(X(k), B(k), frame.dt)
        return [*found, gtsam.WnoaMotionFactorPose3(*ends, self._acceleration**2)]

    def insert(self, values: gtsam.Values, frame: Frame, pose: Array) -> None:
        """Insert the body's twist as well: the recorded one less its bias."""
        super().insert(values, frame, pose)
        values.insert(B(frame.k), self._twist if frame.k else frame.odometry.twist - self._bias)

    def keys(self, k: int) -> list[int]:
        """Keys of a frame's own variables."""
        return [*super().keys(k), B(k)]


class BetweenMotion:
    """The recorded twist less a known bias, as one ``BetweenFactorPose3`` a step, and the vertical velocity.

    The step is :func:`vislam.models.odometry.integrate` with the prior's mean of the bias; there are no other
    variables than poses and heights. What the bias may be off by is nowhere in it, so that an error of the
    bias goes into the poses as if it had been seen, and with it no clock can be estimated.
    """

    information: Mapping[str, str] = {"twist bias": "assumed known"}
    thresholds: Mapping[str, Array] = LINEAR

    def __init__(self, problem: Problem) -> None:
        density = np.maximum(problem.noise.twist, _SMALLEST_DENSITY)
        self._problem, self._noise = problem, replace(problem.noise, twist=density)
        self._height = Height(problem.vertical_velocity)

    def factors(self, frame: Frame, before: Frame | None) -> list[gtsam.NonlinearFactor]:
        """Prior of the first pose or motion, and vertical velocity."""
        if before is None:
            return [_first_pose(self._problem, self._height), *self._height.factors(frame)]
        step = self._step(frame)
        noise = gtsam.noiseModel.Gaussian.Covariance(step.cov)
        motion = gtsam.BetweenFactorPose3(X(before.k), X(frame.k), gtsam.Pose3(step.prev_T_next), noise)
        return [motion, *self._height.factors(frame)]

    def predict(self, frame: Frame, pose: Array) -> Array:
        """Integrate the twist less the bias, and the vertical velocity."""
        if frame.k == 0:
            return pose
        self._height.predict(frame)
        return pose @ self._step(frame).prev_T_next

    def insert(self, values: gtsam.Values, frame: Frame, pose: Array) -> None:
        """Insert pose and height as predicted."""
        values.insert(X(frame.k), gtsam.Pose3(pose))
        self._height.insert(values, frame.k)

    def keys(self, k: int) -> list[int]:
        """Keys of a frame's own variables."""
        return [X(k), *self._height.keys(k)]

    def tied(self, k: int) -> list[int]:
        """All of them."""
        return self.keys(k)

    def read(self, engine: Engine, frame: Frame) -> None:
        """Read nothing: there is no variable but pose and height."""

    def states(self, engine: Engine, frame: Frame, *, with_sigma: bool) -> dict[str, State]:
        """Bias that is assumed known; it is not estimated, and has no standard deviation."""
        del engine, frame, with_sigma
        return {TWIST_BIAS: State(np.array(self._problem.bias_mean))}

    def _step(self, frame: Frame) -> odometry.Step:
        return odometry.integrate(
            frame.odometry.twist, bias=self._problem.bias_mean, dt=frame.dt, noise=self._noise
        )


def make(problem: Problem, *, between: bool = False) -> Motion:
    """Model of motion that a problem asks for; ``between`` is that without a bias."""
    if problem.imu is not None:
        return InertialMotion(problem)
    if between:
        return BetweenMotion(problem)
    return OdometryMotion(problem) if problem.noise.acceleration is None else SmoothMotion(problem)


def newest(motion: Motion, k: int) -> list[int]:
    """Keys of a frame's own variables and of those that the factors of the next frame tie to."""
    return list(dict.fromkeys([*motion.keys(k), *motion.tied(k)]))


def _constants(problem: Problem) -> dict[int, Array]:
    """Prior standard deviations of what is constant all along, by its key, as far as it is not known."""
    sigma = {CLOCK: np.array([problem.clock_sigma]), DIRECTION: np.full(2, problem.velocity_direction_sigma)}
    return {key: spread for key, spread in sigma.items() if spread[0] > 0.0}


def _first_pose(problem: Problem, height: Height) -> gtsam.NonlinearFactor:
    sigma = height.first_pose_sigma(problem.first_pose_sigma)
    return gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), _sigmas(sigma))


def _sigmas(sigma: Any) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigma, float))


def _linear(terms: Mapping[int, Array], right: Array, sigma: Array) -> gtsam.NonlinearFactor:
    """Linear factor of vector variables: ``sum_i A_i x_i = right`` within ``sigma (m,)``."""
    values = gtsam.Values()
    for key, matrix in terms.items():
        values.insert(key, np.zeros(matrix.shape[1]))
    blocks = [part for term in terms.items() for part in term]
    linear: Any = gtsam.JacobianFactor
    return gtsam.LinearContainerFactor(linear(*blocks, right, _sigmas(sigma)), values)
