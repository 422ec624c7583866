"""The recorded twist as the filter's motion model, and the choice of the model."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

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
from vislam.core.step import TWIST_BIAS
from vislam.estimators.ekf.inertial import InertialMotion
from vislam.estimators.ekf.layout import LANDMARK, NavLayout
from vislam.estimators.ekf.propagation import Block, Measurement, Motion, Propagation
from vislam.geometry import se3, so3
from vislam.models import odometry, shared_errors
from vislam.models.imu import STATES
from vislam.models.odometry import POSE
from vislam.models.shared_errors import CLOCK, VELOCITY_DIRECTION, SharedPrior

_SIX = np.eye(6)


class Height:
    """The vertical velocity as a measurement of the height, where it is in use.

    Blocks: ``tilt`` (2), the turn of the true vertical against the world's z axis about x and y [rad], and
    ``height`` (1), the integrated vertical velocity [m].
    """

    def __init__(self, noise: VerticalVelocityNoise | None) -> None:
        self._noise = noise

    def blocks(self) -> Mapping[str, Block]:
        """Blocks in use."""
        if self._noise is None:
            return {}
        return {
            "tilt": Block(np.zeros(2), np.full(2, self._noise.tilt_sigma)),
            "height": Block(np.zeros(1), np.zeros(1)),
        }

    def propagate(self, layout: NavLayout, frame: Frame, change: Array, noise: Array) -> None:
        """Integrate the vertical velocity into ``change`` and ``noise`` of a :class:`Propagation`."""
        if self._noise is not None:
            known, height = math.isfinite(frame.odometry.vertical_velocity), layout["height"]
            change[height] = frame.dt * frame.odometry.vertical_velocity if known else 0.0
            walk = frame.dt * self._noise.walk**2
            noise[height, height] = walk if known else (frame.dt * UNKNOWN_VERTICAL_VELOCITY) ** 2

    def measurements(self, layout: NavLayout, world_T_imu: Array, nav: Array) -> list[Measurement]:
        """Measure the height of the pose by the integrated vertical velocity."""
        if self._noise is None:
            return []
        up, by_tilt = up_axis(nav[layout["tilt"]])
        position = world_T_imu[:3, 3]
        by_nav = np.zeros((1, layout.size))
        by_nav[0, 3:6] = up @ world_T_imu[:3, :3]
        by_nav[0, layout["tilt"]] = position @ by_tilt
        by_nav[0, layout["height"]] = -1.0
        return [Measurement(nav[layout["height"]] - up @ position, by_nav, np.array([HEIGHT_SIGMA**2]))]

    def up(self, layout: NavLayout, nav: Array) -> Array | None:
        """Direction of up by the tilt, where it is estimated."""
        return None if self._noise is None else up_axis(nav[layout["tilt"]])[0]


class OdometryMotion:
    """The recorded twist less its bias (:mod:`vislam.models.odometry`), its clock, and the vertical velocity.

    Blocks: ``twist_bias`` (6) [rad/s, m/s]; ``clock`` (1), how much later the inertial stamps are than taken
    for [s], and ``velocity_direction`` (2), that of the velocity in the body [rad], where their priors are
    not zero; those of :class:`Height`.
    """

    states: tuple[str, ...] = (TWIST_BIAS,)
    information: Mapping[str, str] = {"twist bias": "estimated"}

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._shared = problem.shared()
        self._height = Height(problem.vertical_velocity)

    def blocks(self) -> Mapping[str, Block]:
        """Blocks in use."""
        problem = self._problem
        found = {"twist_bias": Block(problem.bias_mean, np.asarray(problem.bias_sigma))}
        for name in (CLOCK, VELOCITY_DIRECTION):
            if name in self._shared:
                found[name] = _shared_block(name, self._shared[name])
        return {**found, **self._height.blocks()}

    def first(self, layout: NavLayout, nav: Array, frame: Frame) -> Array:
        """Return the prior mean."""
        del layout, frame
        return nav

    def propagate(self, layout: NavLayout, world_T_imu: Array, nav: Array, frame: Frame) -> Propagation:
        """Integrate the twist less its bias, and the vertical velocity."""
        del world_T_imu
        dt, change = frame.dt, np.zeros(layout.size)
        transition, noise = np.eye(layout.size), np.zeros((layout.size, layout.size))
        across = _across(frame)
        step = self._integrated(layout, nav, frame)
        own = slice(0, odometry.NAV)
        transition[own, own], noise[own, own] = odometry.transition(step)
        if CLOCK in layout:
            transition[POSE, layout[CLOCK]] = -(step.by_bias @ frame.odometry.twist_change / dt)[:, None]
        if VELOCITY_DIRECTION in layout:
            transition[POSE, layout[VELOCITY_DIRECTION]] = step.by_bias @ across
        self._walk(layout, dt, noise)
        self._height.propagate(layout, frame, change, noise)
        return Propagation(step.prev_T_next, change, transition, noise)

    def measurements(
        self, layout: NavLayout, world_T_imu: Array, nav: Array, frame: Frame
    ) -> Sequence[Measurement]:
        """Measure the height."""
        del frame
        return self._height.measurements(layout, world_T_imu, nav)

    def up(self, layout: NavLayout, nav: Array) -> Array | None:
        """Direction of up by the tilt, where it is estimated."""
        return self._height.up(layout, nav)

    def _integrated(self, layout: NavLayout, nav: Array, frame: Frame) -> odometry.Step:
        """Step by the twist less its bias, of which the direction of the velocity is a part."""
        late = float(nav[layout[CLOCK]][0]) / frame.dt if CLOCK in layout else 0.0
        bias = nav[layout["twist_bias"]]
        if VELOCITY_DIRECTION in layout:
            bias = bias + _across(frame) @ nav[layout[VELOCITY_DIRECTION]]
        twist = frame.odometry.twist + late * frame.odometry.twist_change
        return odometry.integrate(twist, bias=bias, dt=frame.dt, noise=self._problem.noise)

    def _walk(self, layout: NavLayout, dt: float, noise: Array) -> None:
        """Let the shared errors walk, those of the camera, too."""
        for name, prior in self._shared.items():
            if prior.walk > 0.0 and name in layout:
                noise[layout[name], layout[name]] += dt * prior.walk**2 * np.eye(shared_errors.SIZES[name])


class SmoothMotion(OdometryMotion):
    """The same, of a body that moves smoothly: white noise on its acceleration is all that changes its twist.

    The body's own twist is part of the state, and so is the motion ``xi = log(T_{k-1}^-1 T_k)`` over the
    last step, of which the recorded twist is a measurement: ``u = xi / dt + bias + noise``. So a step without
    tracks is bridged by the inertial sample and by how the body moved before, each by its share. The prior is
    that of Barfoot, Tong and Sarkka, *Batch continuous-time trajectory estimation as exactly sparse Gaussian
    process regression* (RSS 2014), on SE(3) as in Anderson and Barfoot, *Full STEAM ahead* (IROS 2015): over
    a step, in its local coordinates,

        xi = dt twist + w_1,    J_r(xi)^-1 twist' = twist + w_2,

    with w of covariance ``[[dt^3/3, dt^2/2], [dt^2/2, dt]] (x) diag(acceleration^2)``.

    Further blocks: ``twist`` (6) [rad/s, m/s], ``step`` (6), the motion over the last step [rad, m].
    """

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        assert problem.noise.acceleration is not None
        self._acceleration = problem.noise.acceleration
        self._bias_walk, self._twist_noise = np.diag(problem.noise.bias_walk**2), problem.noise.twist**2

    def blocks(self) -> Mapping[str, Block]:
        """Blocks in use; the first twist has a weak prior at the first inertial sample."""
        twist = Block(np.zeros(6), np.sqrt(FIRST_TWIST_S) * self._acceleration)
        return {**super().blocks(), "twist": twist, "step": Block(np.zeros(6), np.zeros(6))}

    def first(self, layout: NavLayout, nav: Array, frame: Frame) -> Array:
        """Take the body's twist from the first inertial sample, less its bias."""
        nav = nav.copy()
        nav[layout["twist"]] = frame.odometry.twist - nav[layout["twist_bias"]]
        return nav

    def propagate(self, layout: NavLayout, world_T_imu: Array, nav: Array, frame: Frame) -> Propagation:
        """Go on with the body's own twist; the bias walks, the vertical velocity is integrated."""
        del world_T_imu
        dt, change = frame.dt, np.zeros(layout.size)
        twist, step, bias = layout["twist"], layout["step"], layout["twist_bias"]
        xi = dt * nav[twist]
        prev_T_next, right = se3.exp(xi), se3.right_jacobian(xi)
        change[step] = xi - nav[step]
        transition = np.eye(layout.size)
        transition[POSE, POSE] = se3.adjoint(se3.inverse(prev_T_next))
        transition[POSE, twist] = dt * right
        transition[step, step] = 0.0
        transition[step, twist] = dt * _SIX
        by = self._by_acceleration(layout, nav, dt, right=right)
        noise = by @ by.T
        noise[bias, bias] += dt * self._bias_walk
        self._walk(layout, dt, noise)
        self._height.propagate(layout, frame, change, noise)
        return Propagation(prev_T_next, change, transition, noise)

    def measurements(
        self, layout: NavLayout, world_T_imu: Array, nav: Array, frame: Frame
    ) -> Sequence[Measurement]:
        """Measure the step by the inertial sample, and the height."""
        found = self._height.measurements(layout, world_T_imu, nav)
        if frame.k == 0:
            return found
        by_nav = np.zeros((6, layout.size))
        by_nav[:, layout["step"]] = _SIX / frame.dt
        by_nav[:, layout["twist_bias"]] = _SIX
        predicted = nav[layout["step"]] / frame.dt + nav[layout["twist_bias"]]
        if VELOCITY_DIRECTION in layout:
            by_nav[:, layout[VELOCITY_DIRECTION]] = _across(frame)
            predicted = predicted + _across(frame) @ nav[layout[VELOCITY_DIRECTION]]
        if CLOCK in layout:
            late = frame.odometry.twist_change / frame.dt
            by_nav[:, layout[CLOCK]] = -late[:, None]
            predicted = predicted - late * nav[layout[CLOCK]]
        variance = self._twist_noise / frame.dt
        return [Measurement(frame.odometry.twist - predicted, by_nav, variance), *found]

    def _by_acceleration(self, layout: NavLayout, nav: Array, dt: float, *, right: Array) -> Array:
        """What white noise of the acceleration, of variance 1, does to the state over a step, ``(d, 12)``.

        With ``half = 1/2 ad(twist)``, to which J_r^-1 is linearised, w_1 moves pose, step and twist by
        ``right (6, 6)`` (the right Jacobian of ``dt`` times the twist), 1 and ``half``, w_2 the twist by
        ``1 - dt half``. The Cholesky factor of their covariance is ``[[a, 0], [b, c]] (x) acceleration``,
        ``a = dt sqrt(dt / 3), b = sqrt(3 dt) / 2, c = sqrt(dt) / 2``.
        """
        root, twist = math.sqrt(dt), layout["twist"]
        first = (dt * root / math.sqrt(3.0)) * self._acceleration
        second = (0.5 * root) * self._acceleration
        both = math.sqrt(3.0) * second
        half = 0.5 * se3.small_adjoint(nav[twist])
        out = np.zeros((layout.size, 12))
        by_second = _SIX - dt * half
        out[POSE, :6], out[layout["step"], :6] = right * first, _SIX * first
        out[twist, :6], out[twist, 6:] = half * first + by_second * both, by_second * second
        return out


def make(problem: Problem) -> Motion:
    """Motion model of a problem."""
    if problem.imu is not None:
        return InertialMotion(problem)
    return OdometryMotion(problem) if problem.noise.acceleration is None else SmoothMotion(problem)


@dataclass(frozen=True)
class Navigation:
    """The navigation state before the first frame.

    Attributes
    ----------
    layout : NavLayout
    world_T_imu : (4, 4)
    nav : (d,)
        Mean, but for the pose.
    cov : (d, d)
    """

    layout: NavLayout
    world_T_imu: Array
    nav: Array
    cov: Array


def navigation(problem: Problem, motion: Motion, *, landmark: int = LANDMARK) -> Navigation:
    """Navigation state before the first frame, of the priors, in a state of landmarks of that size."""
    blocks, shared = dict(motion.blocks()), problem.shared()
    blocks |= {name: _shared_block(name, shared[name]) for name in shared_errors.OF_CAMERA if name in shared}
    layout = NavLayout({name: len(block.mean) for name, block in blocks.items()}, landmark=landmark)
    nav, cov = np.zeros(layout.size), np.zeros((layout.size, layout.size))
    cov[POSE, POSE] = problem.first_pose_cov
    for name, block in blocks.items():
        nav[layout[name]] = block.mean
        cov[layout[name], layout[name]] = np.diag(block.sigma**2)
    if problem.imu is not None:
        rows = np.r_[POSE, *(layout[name] for name in STATES)]
        cov[np.ix_(rows, rows)] = problem.imu.prior.cov
    return Navigation(layout, problem.first_pose, nav, cov)


def _shared_block(name: str, prior: SharedPrior) -> Block:
    size = shared_errors.SIZES[name]
    return Block(np.zeros(size), np.full(size, prior.sigma))


def _across(frame: Frame) -> Array:
    """What the direction of the velocity is in the recorded twist of a step, ``(6, 2)`` [m/s]."""
    return np.asarray(frame.odometry.twist[3] * odometry.ACROSS)


def up_axis(tilt: Array) -> tuple[Array, Array]:
    """Up ``(3,)`` in a world tilted by ``(2,)`` [rad] about x and y, and its derivative ``(3, 2)``."""
    x, y = tilt.tolist()
    # With the left Jacobian J of omega = (x, y, 0), exp(omega) is 1 + hat(omega) J, and d up = (J d) x up.
    a, b, c, d, e, f, g, h, i = so3.left_jacobian_entries(x, y, 0.0)
    p, q, r = y * i, -x * i, 1.0 + x * f - y * c
    by_tilt = [[d * r - g * q, e * r - h * q], [g * p - a * r, h * p - b * r], [a * q - d * p, b * q - e * p]]
    return np.array([p, q, r]), np.array(by_tilt)
