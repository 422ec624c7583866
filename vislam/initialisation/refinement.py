"""All that a window says of the first state at once: a maximum a posteriori estimate, by Gauss-Newton.

Unknown are the tilt of the first pose, which is gravity's direction on the sphere of its known magnitude, all
further poses, all velocities, and biases that stand still over the window. Known are preintegrated inertia
(Forster et al. 2017, eq. 45), the motion of the tracks from frame to frame, and a prior of the biases.

The stated noises are not believed: where the sum of squares of all residuals is above the redundancy, all
variances are scaled by the ratio. One factor for both, as tracks and gyro observe the same turns of the same
steps, and their residuals do not tell whose error they are.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.geometry import se3, so3
from vislam.initialisation.alignment import Aligned
from vislam.initialisation.found import SIZE, Found, bias_prior
from vislam.initialisation.settings import InitialisationSettings
from vislam.initialisation.window import Window
from vislam.models.imu import ImuNoise
from vislam.models.preintegration import MOTION, Preintegrated

_ITERATIONS = 8
_CONVERGED = 1e-7
_EACH = 9
"""Unknowns of a further frame: pose (omega, v) on its right, velocity in the world."""


@dataclass(frozen=True)
class _State:
    """Poses ``(K + 1, 4, 4)`` and velocities ``(K + 1, 3)`` in the world, biases ``(6,)``."""

    pose: Array
    velocity: Array
    bias: Array

    def moved(self, step: Array) -> "_State":
        """Step ``(11 + 9 K,)``: first the errors of the first state, then those of each further frame."""
        first, further = step[:SIZE], step[SIZE:].reshape(-1, _EACH)
        pose, velocity = self.pose.copy(), self.velocity.copy()
        pose[0, :3, :3] = so3.exp(np.array([*first[:2], 0.0])) @ pose[0, :3, :3]
        pose[1:] = se3.retract(pose[1:], further[:, :6])
        velocity[0] += first[2:5]
        velocity[1:] += further[:, 6:]
        return _State(pose, velocity, self.bias + first[5:])


def refine(window: Window, aligned: Aligned, noise: ImuNoise, settings: InitialisationSettings) -> Found:
    """Estimate of the first state from an aligned window."""
    state = _start(window, aligned, noise)
    prior = bias_prior(settings)
    scale = 1.0
    for _ in range(_ITERATIONS):
        normal = _normal(window, state, noise)
        redundancy = normal.rows - len(normal.gradient) + np.count_nonzero(prior.diagonal())
        scale = max(normal.square / redundancy, 1.0)
        hessian, gradient = normal.hessian / scale, normal.gradient / scale
        hessian[:SIZE, :SIZE] += prior
        gradient[:SIZE] -= prior @ np.concatenate([np.zeros(5), state.bias])
        step = np.asarray(np.linalg.solve(hessian, gradient), float)
        state = state.moved(step)
        if np.abs(step).max() < _CONVERGED:
            break
    first = np.linalg.inv(hessian)[:SIZE, :SIZE]
    information = np.linalg.inv(first) - prior
    return Found(
        "dynamic",
        state.pose[0, :3, :3],
        state.velocity[0],
        state.bias[:3],
        state.bias[3:],
        0.5 * (information + information.T),
        prior,
        variance_factor=float(scale),
    )


def _start(window: Window, aligned: Aligned, noise: ImuNoise) -> _State:
    """Poses of the tracks, turned so that gravity points down; velocities by inertia."""
    turn = so3.onto(aligned.gravity, noise.gravity_world)
    world_T_first = se3.from_rotation_translation(turn, np.zeros(3))
    pose = world_T_first @ window.poses()
    velocity = np.empty((len(pose), 3))
    velocity[0] = turn @ aligned.velocity
    steps = window.preintegrated(noise, aligned.gyro_bias, np.zeros(3))
    for k, step in enumerate(steps):
        velocity[k + 1] = velocity[k] + noise.gravity_world * step.time + pose[k, :3, :3] @ step.velocity
    return _State(pose, velocity, np.concatenate([aligned.gyro_bias, np.zeros(3)]))


@dataclass
class _Normal:
    """Normal equations: ``J^T W J``, ``-J^T W r``, ``r^T W r``, rows."""

    hessian: Array
    gradient: Array
    square: float = 0.0
    rows: int = 0

    def add(self, where: IntArray, jacobian: Array, *, residual: Array, cov: Array) -> None:
        """Add a measurement of some of the unknowns."""
        weighted = np.linalg.solve(cov, np.column_stack([jacobian, residual]))
        self.hessian[np.ix_(where, where)] += jacobian.T @ weighted[:, :-1]
        self.gradient[where] -= jacobian.T @ weighted[:, -1]
        self.square += float(residual @ weighted[:, -1])
        self.rows += len(residual)


def _normal(window: Window, state: _State, noise: ImuNoise) -> _Normal:
    """Normal equations of inertia and tracks."""
    size = SIZE + _EACH * len(window)
    normal = _Normal(np.zeros((size, size)), np.zeros(size))
    first = _first_by_tilt(state.pose[0, :3, :3])
    for k, step in enumerate(window.preintegrated(noise, state.bias[:3], state.bias[3:])):
        residual, jacobian = _inertial(state, k, step, noise)
        normal.add(*_columns(k, jacobian, first), residual=residual, cov=step.cov[MOTION, MOTION])
        if window.told[k]:
            residual, jacobian = _tracked(state, k, window.motion[k])
            normal.add(*_columns(k, jacobian, first), residual=residual, cov=window.cov[k])
    return normal


def _first_by_tilt(world_R_imu: Array) -> Array:
    """Error of the first frame (pose on its right, velocity) by tilt and velocity, ``(9, 5)``."""
    out = np.zeros((_EACH, 5))
    out[:3, :2] = world_R_imu.T[:, :2]
    out[6:, 2:] = np.eye(3)
    return out


def _columns(k: int, jacobian: tuple[Array, Array, Array], first: Array) -> tuple[IntArray, Array]:
    """Unknowns of a step, and the Jacobian by them of what it is by frame before, frame after, biases."""
    before, after, bias = jacobian
    start = SIZE + _EACH * k
    earlier = np.arange(5) if k == 0 else np.arange(start - _EACH, start)
    before = before @ first if k == 0 else before
    where = np.concatenate([np.arange(5, SIZE), earlier, np.arange(start, start + _EACH)])
    return where, np.hstack([bias, before, after])


def _inertial(
    state: _State, k: int, step: Preintegrated, noise: ImuNoise
) -> tuple[Array, tuple[Array, Array, Array]]:
    """Residual (theta, p, v) of a preintegrated step, and Jacobians ``(9, 9)``, ``(9, 9)``, ``(9, 6)``."""
    one, two = state.pose[k], state.pose[k + 1]
    turn, time = one[:3, :3], step.time
    ahead = two[:3, 3] - one[:3, 3] - state.velocity[k] * time - 0.5 * noise.gravity_world * time**2
    faster = state.velocity[k + 1] - state.velocity[k] - noise.gravity_world * time
    i_R_j = turn.T @ two[:3, :3]
    theta = so3.log(step.rotation.T @ i_R_j)
    ahead, faster = turn.T @ ahead, turn.T @ faster
    residual = np.concatenate([theta, ahead - step.position, faster - step.velocity])
    by_theta = np.linalg.inv(so3.left_jacobian(-theta))
    before, after = np.zeros((9, 9)), np.zeros((9, 9))
    before[:3, :3], after[:3, :3] = -by_theta @ i_R_j.T, by_theta
    before[3:6, :3], before[6:, :3] = so3.hat(ahead), so3.hat(faster)
    before[3:6, 3:6], after[3:6, 3:6] = -np.eye(3), i_R_j
    before[3:6, 6:], before[6:, 6:], after[6:, 6:] = -time * turn.T, -turn.T, turn.T
    return residual, (before, after, -step.by_bias)


def _tracked(state: _State, k: int, motion: Array) -> tuple[Array, tuple[Array, Array, Array]]:
    """Residual ``(6,)`` of a step of the tracks, and Jacobians ``(6, 9)``, ``(6, 9)``, ``(6, 6)``."""
    prev_T_next = se3.inverse(state.pose[k]) @ state.pose[k + 1]
    residual = se3.local(motion, prev_T_next)
    by_error = np.linalg.inv(se3.right_jacobian(residual))
    before, after = np.zeros((6, 9)), np.zeros((6, 9))
    before[:, :6] = -by_error @ se3.adjoint(se3.inverse(prev_T_next))
    after[:, :6] = by_error
    return residual, (before, after, np.zeros((6, 6)))
