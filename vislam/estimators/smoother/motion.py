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
from vislam.estimators.smoother.keys import LINEAR, PIXEL_ERRORS, B, H, V, W, X
from vislam.estimators.smoother.linear import linear_factor
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.pixel_errors import KnownCamera, PixelErrors
from vislam.estimators.smoother.twist_errors import TwistErrors
from vislam.geometry import se3
from vislam.models import CameraErrors, odometry

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

    def rotation(self, k: int) -> int | None:
        """Key of the rotation of the cameras at a frame; None where it is known."""
        ...

    @property
    def pixels(self) -> "PixelErrors | None":
        """Shared errors of the pixels, if any is not known."""
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


class OdometryMotion(KnownCamera):
    """The recorded twist less its bias, its clock, and the vertical velocity, in the project's tangent order.

    The motion over a step is ``log(T_{k-1}^-1 T_k) = dt w_k + n`` with w the inertial twist less its bias and
    n of covariance ``dt diag(density^2)``: :func:`vislam.models.odometry.integrate` with the noise told on
    the twist. GTSAM has it as a part of its white-noise-on-acceleration prior (Anderson and Barfoot, IROS
    2015), between a pose and a twist before and after. Its twist after the step is here a variable of its
    own, ``V(k)``, in no other factor: it takes up the other half of the error whatever that is, and of the
    first half, whose covariance is ``dt^3 / 3 Qc``, nothing is lost.

    As w is the variable and not the bias, the walk of the bias is ``w_{k+1} - w_k = u_{k+1} - u_k + n``. The
    clock, the direction of the velocity in the body and the rotation of the cameras stand in the prior of the
    bias and in its walk, linearly (:mod:`vislam.estimators.smoother.twist_errors`).

    The vertical velocity enters by :class:`Height`; without it the first pose is the identity within its
    prior.
    """

    information: Mapping[str, str] = {"twist bias": "estimated"}
    thresholds: Mapping[str, Array] = LINEAR

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._shared = TwistErrors(problem.shared())
        # Of what the prior has for its mean, and along the axes of the cameras.
        self._bias = np.zeros(6)
        self._twist = np.zeros(6)
        self._height = Height(problem.vertical_velocity)

    def rotation(self, k: int) -> int | None:
        """Key of the rotation of the cameras at a frame; None where it is known."""
        return self._shared.rotation(k) if self._shared.turned else None

    def factors(self, frame: Frame, before: Frame | None) -> list[gtsam.NonlinearFactor]:
        """Priors, motion, walk of the bias, vertical velocity."""
        k, problem = frame.k, self._problem
        shared = self._shared.factors(frame, before)
        if before is None:
            first = _first_pose(problem, self._height, rotation=self.rotation(0))
            return [first, *self._height.factors(frame), *shared]
        end = gtsam.StateData(X(k), V(k), frame.dt)
        density = np.maximum(problem.noise.twist, _SMALLEST_DENSITY)
        return [
            gtsam.WnoaMotionFactorPose3(
                gtsam.StateData(X(k - 1), W(k), 0.0), end, 3.0 * (density / frame.dt) ** 2
            ),
            *shared,
            self._bias_factor(frame, before),
            *self._height.factors(frame),
        ]

    def predict(self, frame: Frame, pose: Array) -> Array:
        """Integrate the twist less its bias, and the vertical velocity."""
        if frame.k == 0:
            return pose
        self._twist = self._shared.recorded(frame, self._problem.bias_mean)[0] - self._bias
        self._height.predict(frame)
        return pose @ se3.exp(frame.dt * self._twist)

    def insert(self, values: gtsam.Values, frame: Frame, pose: Array) -> None:
        """Insert pose, twist, constants and height as predicted."""
        k = frame.k
        values.insert(X(k), gtsam.Pose3(pose))
        if k > 0:
            values.insert(W(k), self._twist)
            values.insert(V(k), self._twist)
        self._shared.insert(values, k)
        self._height.insert(values, k)

    def keys(self, k: int) -> list[int]:
        """Keys of a frame's own variables."""
        own = [W(k), V(k)] if k > 0 else []
        return [X(k), *own, *self._height.keys(k), *self._shared.keys(k)]

    def tied(self, k: int) -> list[int]:
        """Keys that the factors of the next frame tie to."""
        found = [*(key for key in self.keys(k) if key != V(k)), *self._shared.tied(k)]
        return list(dict.fromkeys(found))

    def read(self, engine: Engine, frame: Frame) -> None:
        """Read shared errors and bias."""
        for name, key in self._shared.last(frame.k).items():
            self._shared.values[name] = engine.vector(key)
        if frame.k > 0:
            twist, _ = self._shared.recorded(frame, self._problem.bias_mean)
            self._bias = twist - engine.vector(W(frame.k))

    def states(self, engine: Engine, frame: Frame, *, with_sigma: bool) -> dict[str, State]:
        """Bias at the end of the step, with the shared errors' share in the variance of the twist; these."""
        bias = self._problem.bias_mean + self._shared.turn_back(self._bias)
        sigma = None
        if with_sigma:
            sigma = np.array(self._problem.bias_sigma)
            if frame.k > 0:
                walk = frame.dt * self._problem.noise.bias_walk**2
                sigma = np.sqrt(np.diagonal(engine.covariance(W(frame.k))) + walk)
        found = {TWIST_BIAS: State(bias, sigma)}
        keys = self._shared.last(frame.k)
        for name, value in self._shared.values.items():
            spread = None
            if with_sigma and name in keys:
                walked = self._shared.walked(name, frame)
                spread = np.sqrt(np.diagonal(engine.covariance(keys[name])) + walked)
            found[name] = State(value.copy(), spread)
        return found

    def _bias_factor(self, frame: Frame, before: Frame) -> gtsam.NonlinearFactor:
        """Tie of the twist less its bias: the prior of the bias at the first step, its walk after that."""
        problem, key = self._problem, W(frame.k)
        constant, terms = self._shared.terms(frame, problem.bias_mean, self._bias)
        if before.k == 0:
            sigma = np.asarray(problem.bias_sigma)
            if not terms:
                return gtsam.PriorFactorVector(key, constant, _sigmas(sigma))
            return linear_factor(
                {key: np.eye(6), **{name: -matrix for name, matrix in terms.items()}}, constant, sigma
            )
        earlier, others = self._shared.terms(before, problem.bias_mean, self._bias)
        change, sigma = constant - earlier, np.sqrt(before.dt) * problem.noise.bias_walk
        if not terms:
            return gtsam.BetweenFactorVector(W(before.k), key, change, _sigmas(sigma))
        joined = {name: -matrix for name, matrix in terms.items()}
        for name, matrix in others.items():
            joined[name] = joined[name] + matrix if name in joined else matrix
        return linear_factor({W(before.k): -np.eye(6), key: np.eye(6), **joined}, change, sigma)


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
            mean, _ = self._shared.recorded(frame, self._problem.bias_mean)
            sigma = np.sqrt(FIRST_TWIST_S) * self._acceleration
            return [*found, gtsam.PriorFactorVector(B(0), mean, _sigmas(sigma))]
        ends = gtsam.StateData(X(k - 1), B(k - 1), 0.0), gtsam.StateData(X(k), B(k), frame.dt)
        return [*found, gtsam.WnoaMotionFactorPose3(*ends, self._acceleration**2)]

    def insert(self, values: gtsam.Values, frame: Frame, pose: Array) -> None:
        """Insert the body's twist as well: the recorded one less its bias."""
        super().insert(values, frame, pose)
        first, _ = self._shared.recorded(frame, self._problem.bias_mean)
        values.insert(B(frame.k), self._twist if frame.k else first - self._bias)

    def keys(self, k: int) -> list[int]:
        """Keys of a frame's own variables."""
        return [*super().keys(k), B(k)]


class BetweenMotion(KnownCamera):
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


class WithPixelErrors:
    """A model of motion, and the shared errors of the pixels, which are carried from frame to frame.

    Parameters
    ----------
    motion : Motion
    pixels : PixelErrors
    """

    def __init__(self, motion: Motion, pixels: PixelErrors) -> None:
        self._motion, self.pixels = motion, pixels
        self.information = motion.information
        self.thresholds: Mapping[str, Array] = {**motion.thresholds, **PIXEL_ERRORS}

    def factors(self, frame: Frame, before: Frame | None) -> Sequence[gtsam.NonlinearFactor]:
        """Those of the motion, and priors and walks of the errors."""
        return [*self._motion.factors(frame, before), *self.pixels.factors(frame)]

    def predict(self, frame: Frame, pose: Array) -> Array:
        """Predict by the motion."""
        return self._motion.predict(frame, pose)

    def insert(self, values: gtsam.Values, frame: Frame, pose: Array) -> None:
        """Insert the calibrations as well."""
        self._motion.insert(values, frame, pose)
        self.pixels.insert(values, frame.k)

    def keys(self, k: int) -> list[int]:
        """Keys of a frame's own variables, its calibrations among them where they walk."""
        return [*self._motion.keys(k), *(self.pixels.keys(k) if self.pixels.walks else [])]

    def tied(self, k: int) -> list[int]:
        """Keys that the factors of the next frame tie to."""
        return [*self._motion.tied(k), *self.pixels.keys(k), *self.pixels.mountings()]

    def read(self, engine: Engine, frame: Frame) -> None:
        """Read the errors as well."""
        self._motion.read(engine, frame)
        left, right = (engine.calibration(key(frame.k)) for key in (self.pixels.left, self.pixels.right))
        self.pixels.errors = CameraErrors.of(self.pixels.values(left, right))

    def states(self, engine: Engine, frame: Frame, *, with_sigma: bool) -> dict[str, State]:
        """Those of the motion, and the errors."""
        found, keys = self._motion.states(engine, frame, with_sigma=with_sigma), self.pixels.keys(frame.k)
        sigma = self.pixels.sigmas(engine.joint_covariance(keys)) if with_sigma else {}
        for name, value in self.pixels.errors.values().items():
            if name in self.pixels.names:
                found[name] = State(value, sigma.get(name))
        return found

    def rotation(self, k: int) -> int | None:
        """Key of the rotation of the cameras at a frame; None where it is known."""
        return self._motion.rotation(k)


def make(problem: Problem, options: SmootherOptions) -> Motion:
    """Model of motion that a problem and the options ask for."""
    if options.motion == "between":
        return BetweenMotion(problem)
    pixels = PixelErrors(problem.rig, problem.shared(), factorization=options.factorization)
    return WithPixelErrors(_plain(problem), pixels) if pixels.names else _plain(problem)


def _plain(problem: Problem) -> Motion:
    """Model of motion alone."""
    if problem.imu is not None:
        return InertialMotion(problem)
    return OdometryMotion(problem) if problem.noise.acceleration is None else SmoothMotion(problem)


def newest(motion: Motion, k: int) -> list[int]:
    """Keys of a frame's own variables and of those that the factors of the next frame tie to."""
    return list(dict.fromkeys([*motion.keys(k), *motion.tied(k)]))


def _first_pose(problem: Problem, height: Height, *, rotation: int | None = None) -> gtsam.NonlinearFactor:
    """Prior of the first pose, which the rotation of the cameras turns where the world is the vertical's."""
    sigma = _sigmas(height.first_pose_sigma(problem.first_pose_sigma))
    if rotation is None or problem.vertical_velocity is None:
        return gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), sigma)
    at = gtsam.Values()
    at.insert(X(0), gtsam.Pose3())
    at.insert(rotation, np.zeros(3))
    turned = np.concatenate([-np.eye(3), np.zeros((3, 3))])
    spread = height.first_pose_sigma(problem.first_pose_sigma)
    return linear_factor({X(0): np.eye(6), rotation: turned}, np.zeros(6), spread, at=at)


def _sigmas(sigma: Any) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigma, float))
