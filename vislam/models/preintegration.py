"""Preintegration of inertial samples between two frames, used by filters and smoothers alike.

Without the state at its beginning, what an accelerometer and a gyro have measured over a step of length t is
a relative motion ``(R, p, v)`` in the frame of the first pose, so that (Forster, Carlone, Dellaert,
Scaramuzza, *On-manifold preintegration for real-time visual-inertial odometry*, TRO 33 (2017), eqs. 30 to 38)

    R_j = R_i R,    v_j = v_i + g t + R_i v,    p_j = p_i + v_i t + g t^2 / 2 + R_i p.

Over an interval both signals are taken for constant in the body, for which the step is exact: with
``phi = (gyro - b_g) dt``, ``a = accel - b_a``,

    R <- R exp(phi),    v <- v + R Gamma_1(phi) a dt,    p <- p + v dt + R Gamma_2(phi) a dt^2,

``Gamma_n(phi) = sum_k hat(phi)^k / (k + n)!``; Gamma_1 is the left Jacobian (the exponential of the Galilean
group; Fourmy, Atchuthan, Mansard, Sola, Flayols, *Absolute humanoid localization and mapping based on IMU Lie
group and fiducial markers*, Humanoids 2019). What an error of one interval makes of the end of the step has a
closed form, so that nothing but the products of the rotations is a recursion, and these are taken by
doubling: no loop over samples.

Errors are ``R exp(theta)``, ``p + dp``, ``v + dv``, in the order (theta, p, v).
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.geometry import se3, so3
from vislam.models.imu import IMU_NAV, ImuNoise

MOTION = slice(0, 9)
"""Where the relative motion stands in the covariance, and behind it the biases."""
BIASES = slice(9, 15)
_ONE = np.eye(3)


@dataclass(frozen=True)
class Preintegrated:
    """Relative motion over a step.

    Attributes
    ----------
    time : float
        Length of the step [s].
    rotation : (3, 3)
        ``i_R_j``.
    position, velocity : (3,)
        Without gravity and the first velocity, in the frame of the first pose [m], [m/s].
    by_bias : (9, 6)
        Derivative of (theta, p, v) by the bias (gyro, accelerometer).
    cov : (15, 15)
        Covariance of (theta, p, v) and of what the biases (gyro, accelerometer) change by over the step. A
        bias that walks within the step correlates the two.
    """

    time: float
    rotation: Array
    position: Array
    velocity: Array
    by_bias: Array
    cov: Array

    def corrected(self, change: Array) -> tuple[Array, Array, Array]:
        """Rotation, position and velocity to first order in a change ``(6,)`` of the bias (eq. 44)."""
        theta, position, velocity = np.split(self.by_bias @ change, 3)
        return self.rotation @ so3.exp(theta), self.position + position, self.velocity + velocity

    def predict(
        self, pose: Array, velocity: Array, gravity: Array, *, earth_rate: Array | None = None
    ) -> tuple[Array, Array]:
        """Pose ``(4, 4)`` and velocity ``(3,)`` at the end of the step, in the world.

        Parameters
        ----------
        pose : (4, 4)
            ``world_T_imu`` at its beginning.
        velocity : (3,)
            In the world [m/s].
        gravity : (3,)
            [m/s^2]; with an earth rate what a plumb line shows, the centrifugal part included.
        earth_rate : (3,), optional
            How the world turns against inertial space, along its own axes [rad/s]; gravity is then what a
            plumb line shows, the centrifugal part included. Of first order in it, and the specific force
            taken for even over the step in what it does to the position: with ``R(s) = exp(-Omega s) R_i
            R_i(s)`` and the acceleration ``f + g - 2 Omega x v`` in the turning world.
        """
        time, turn = self.time, pose[:3, :3]
        position, faster = turn @ self.position, turn @ self.velocity
        ahead = velocity * time + 0.5 * gravity * time**2 + position
        after = velocity + gravity * time + faster
        turned = turn @ self.rotation
        if earth_rate is not None:
            after = after - np.cross(earth_rate, time * faster - position + 2.0 * ahead)
            by_rate = velocity * time**2 + gravity * time**3 / 3.0 + time * position
            ahead = ahead - np.cross(earth_rate, by_rate)
            turned = so3.exp(-time * earth_rate) @ turned
        return se3.from_rotation_translation(turned, pose[:3, 3] + ahead), after

    def linear(self, turn: Array) -> tuple[Array, Array]:
        """Transition F and noise Q ``(15, 15)`` of the error over the step.

        The error is (omega, v) of the pose on its right, of the velocity in the world, of the biases of gyro
        and accelerometer; derivatives of :meth:`predict`.

        Parameters
        ----------
        turn : (3, 3)
            Attitude ``world_R_imu`` at the beginning of the step.
        """
        back = self.rotation.T
        # From (theta, p, v) of the step, the latter two in the first body, to pose and velocity.
        to_error = np.eye(IMU_NAV)
        to_error[3:6, 3:6], to_error[6:9, 6:9] = back, turn
        transition = np.eye(IMU_NAV)
        transition[:3, :3] = transition[3:6, 3:6] = back
        transition[3:6, :3] = -back @ so3.hat(self.position)
        transition[3:6, 6:9] = self.time * back @ turn.T
        transition[6:9, :3] = -turn @ so3.hat(self.velocity)
        transition[MOTION, BIASES] = to_error[MOTION, MOTION] @ self.by_bias
        return transition, np.asarray(to_error @ self.cov @ to_error.T)


def preintegrate(
    dt: Array,
    gyro: Array,
    accel: Array,
    *,
    gyro_bias: Array,
    accel_bias: Array,
    noise: ImuNoise,
    unknown: Array | None = None,
) -> Preintegrated:
    """Preintegrate the samples of a step.

    Parameters
    ----------
    dt : (m,)
        Lengths of the intervals, each above 0 [s].
    gyro, accel : (m, 3)
        Means over them [rad/s], [m/s^2].
    gyro_bias, accel_bias : (3,)
        [rad/s], [m/s^2].
    noise : ImuNoise
    unknown : (m, 2), optional
        Variance of the errors of rate and force in each interval besides that of the noise, where no samples
        cover it [rad^2/s^2], [m^2/s^4]. It is taken for white within the interval, so that position and
        velocity are not known to be off together.
    """
    total = float(dt.sum())
    phi, force = dt[:, None] * (gyro - gyro_bias), accel - accel_bias
    increments = _Increments.of(dt, phi, force)
    turns = _products(increments.rotation)
    start, after = turns[:-1], turns[1:]
    faster = _rotated(start, increments.velocity)
    speed = np.concatenate([np.zeros((1, 3)), np.cumsum(faster, axis=0)])
    moved = speed[:-1] * dt[:, None] + _rotated(start, increments.position)
    place = np.concatenate([np.zeros((1, 3)), np.cumsum(moved, axis=0)])
    by_noise = _to_the_end(dt, increments, turns, speed, place)
    return Preintegrated(
        time=total,
        rotation=after[-1],
        position=place[-1],
        velocity=speed[-1],
        by_bias=-by_noise.sum(axis=0),
        cov=_covariance(dt, by_noise, noise, unknown),
    )


@dataclass(frozen=True)
class _Increments:
    """What each interval adds, in the body at its beginning, and the derivatives by its rate and force.

    Attributes
    ----------
    rotation : (m, 3, 3)
    velocity, position : (m, 3)
    turn_by_rate, velocity_by_rate, position_by_rate : (m, 3, 3)
    velocity_by_force, position_by_force : (m, 3, 3)
    """

    rotation: Array
    velocity: Array
    position: Array
    turn_by_rate: Array
    velocity_by_rate: Array
    position_by_rate: Array
    velocity_by_force: Array
    position_by_force: Array

    @classmethod
    def of(cls, dt: Array, phi: Array, force: Array) -> "_Increments":
        """Of intervals ``(m,)`` with turns ``phi (m, 3)`` and specific forces ``(m, 3)``."""
        long, matrix = dt[:, None, None], so3.hat(phi)
        square, angle = matrix @ matrix, np.sqrt(np.einsum("mi,mi->m", phi, phi))
        third = so3.sine_coefficient(angle)[:, None, None]
        # (a^2 / 2 + cos a - 1) / a^4 by its series, as an interval turns by a fraction of a radian.
        fourth = (1.0 / 24.0 - angle**2 / 720.0 + angle**4 / 40320.0)[:, None, None]
        first = _ONE + so3.cosine_coefficient(angle)[:, None, None] * matrix + third * square
        second = 0.5 * _ONE + third * matrix + fourth * square
        by_turn = _by_turn(matrix, force)
        return cls(
            rotation=_ONE + matrix @ first,
            velocity=dt[:, None] * _rotated(first, force),
            position=dt[:, None] ** 2 * _rotated(second, force),
            turn_by_rate=long * first.transpose(0, 2, 1),
            velocity_by_rate=long**2 * by_turn[0],
            position_by_rate=long**3 * by_turn[1],
            velocity_by_force=long * first,
            position_by_force=long**2 * second,
        )


def _by_turn(turn: Array, force: Array) -> tuple[Array, Array]:
    """Derivatives ``(m, 3, 3)`` of ``Gamma_1(phi) a`` and ``Gamma_2(phi) a`` by phi, to third order in phi.

    That of ``hat(phi)^k a`` is minus ``D_k = hat(hat(phi)^{k-1} a) + hat(phi) D_{k-1}``.
    """
    pull = so3.hat(force)
    turned = _rotated(turn, force)
    twice = so3.hat(turned) + turn @ pull
    thrice = so3.hat(_rotated(turn, turned)) + turn @ twice
    return -(pull / 2.0 + twice / 6.0 + thrice / 24.0), -(pull / 6.0 + twice / 24.0 + thrice / 120.0)


def _products(rotation: Array) -> Array:
    """Products ``R_0 ... R_{i-1}`` of rotations ``(m, 3, 3)``, ``(m + 1, 3, 3)``, by doubling.

    Hillis and Steele, *Data parallel algorithms*, CACM 29 (1986).
    """
    out = np.concatenate([np.eye(3)[None], rotation])
    step = 1
    while step < len(out):
        out[step:] = out[:-step] @ out[step:]
        step *= 2
    return out


def _to_the_end(dt: Array, step: _Increments, turns: Array, speed: Array, place: Array) -> Array:
    """What an error of rate and force in each interval makes of (theta, p, v) at the end, ``(m, 9, 6)``.

    Behind interval i, whose own errors are theta_i, p_i and v_i, the rest of the step is what it was, turned:
    ``v += R_{i+1} theta_i x (v_end - v_{i+1})``, and p likewise, to which v_i adds for the rest of the time.
    """
    start, after = turns[:-1], turns[1:]
    left = (np.cumsum(dt[::-1])[::-1] - dt)[:, None]
    turned = after @ step.turn_by_rate
    out = np.zeros((len(dt), 9, 6))
    out[:, :3, :3] = turns[-1].T @ turned
    faster = start @ step.velocity_by_rate
    stronger = start @ step.velocity_by_force
    rest = speed[-1] - speed[1:]
    out[:, 6:, :3] = faster - so3.hat(rest) @ turned
    out[:, 6:, 3:] = stronger
    farther = place[-1] - place[1:] - left * speed[1:]
    left = left[:, :, None]
    out[:, 3:6, :3] = start @ step.position_by_rate + left * faster - so3.hat(farther) @ turned
    out[:, 3:6, 3:] = start @ step.position_by_force + left * stronger
    return out


def _covariance(dt: Array, by_noise: Array, noise: ImuNoise, unknown: Array | None) -> Array:
    """Covariance ``(15, 15)`` of the motion and of what the biases change by."""
    density = np.repeat([noise.gyro_density, noise.accel_density], 3)
    variance = density**2 / dt[:, None]
    if unknown is not None:
        variance = variance + np.repeat(unknown, 3, axis=1)
    # The bias steps at the end of each interval: what it then is off by is as an error of all later ones.
    later = np.cumsum(by_noise[::-1], axis=0)[::-1] - by_noise
    walk = np.repeat([noise.gyro_walk, noise.accel_walk], 3) ** 2 * dt[:, None]
    out = np.zeros((15, 15))
    for matrix, spread in ((by_noise, variance), (later, walk)):
        flat = (matrix * np.sqrt(spread)[:, None, :]).transpose(1, 0, 2).reshape(9, -1)
        out[MOTION, MOTION] += flat @ flat.T
    if unknown is not None:
        # What is not known varies within an interval: white noise goes dt^3 / 3 far, a constant dt^3 / 4.
        out[3:6, 3:6] += np.sum(unknown[:, 1] * dt**4) / 12.0 * np.eye(3)
    out[MOTION, BIASES] = -np.einsum("nij,nj->ij", later, walk)
    out[BIASES, MOTION] = out[MOTION, BIASES].T
    out[BIASES, BIASES] = np.diag(walk.sum(axis=0))
    return out


def _rotated(matrix: Array, vector: Array) -> Array:
    """Products of matrices ``(m, 3, 3)`` and vectors ``(m, 3)``."""
    return np.asarray((matrix @ vector[:, :, None])[:, :, 0])
