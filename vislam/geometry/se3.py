"""Poses as ``(..., 4, 4)`` arrays: exponential, logarithm, adjoint and right Jacobian in batch form.

The order of tangent vectors is (omega, v); see the package docstring for all conventions.
"""

import math

import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.geometry import so3

_LAST_ROW = np.array([0.0, 0.0, 0.0, 1.0])
_SMALL_ANGLE = 5e-2
"""Below this angle [rad] the fifth-order coefficient of :func:`left_jacobian` comes from its series."""


def from_rotation_translation(rotation: Array, translation: Array) -> Array:
    """Pose ``(..., 4, 4)`` from a rotation ``(..., 3, 3)`` and a translation ``(..., 3)`` [m]."""
    batch = np.broadcast_shapes(rotation.shape[:-2], translation.shape[:-1])
    pose = np.zeros((*batch, 4, 4))
    pose[..., :3, :3] = rotation
    pose[..., :3, 3] = translation
    pose[..., 3, 3] = 1.0
    return pose


def is_rigid(pose: Array, *, tolerance: float) -> BoolArray:
    """Which of matrices ``(..., 4, 4)`` are rigid transforms, their R^T R off from the identity by less."""
    off, determinant = so3.defect(pose[..., :3, :3])
    whole = np.all(pose[..., 3, :] == _LAST_ROW, axis=-1)
    return np.asarray((off < tolerance) & (determinant > 0.0) & whole)


def inverse(pose: Array) -> Array:
    """Inverse of a rigid transform, ``(..., 4, 4)``."""
    if pose.ndim == 2:
        return _inverse_of_one(pose)
    out = np.zeros(pose.shape)
    out[..., :3, :3] = np.swapaxes(pose[..., :3, :3], -1, -2)
    out[..., :3, 3] = -(out[..., :3, :3] @ pose[..., :3, 3, None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def _inverse_of_one(pose: Array) -> Array:
    (a, b, c, x), (d, e, f, y), (g, h, i, z), _ = pose.tolist()
    return np.array(
        [
            [a, d, g, -(a * x + d * y + g * z)],
            [b, e, h, -(b * x + e * y + h * z)],
            [c, f, i, -(c * x + f * y + i * z)],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def exp(xi: Array) -> Array:
    """Pose ``(..., 4, 4)`` of a tangent vector ``(..., 6)`` = (omega [rad], v [m])."""
    if xi.ndim == 1:
        return _exp_of_one(xi)
    omega, v = xi[..., :3], xi[..., 3:]
    jacobian = so3.left_jacobian(omega)
    # The left Jacobian J holds the rotation as well: it is 1 + hat(omega) J.
    out = np.zeros((*xi.shape[:-1], 4, 4))
    out[..., :3, :3] = np.eye(3) + so3.hat(omega) @ jacobian
    out[..., :3, 3] = (jacobian @ v[..., None])[..., 0]
    out[..., 3, 3] = 1.0
    return out


def _exp_of_one(xi: Array) -> Array:
    """Pose of a single tangent vector, which filters ask for at every step, without an array on the way."""
    x, y, z, u, v, w = xi.tolist()
    a, b, c, d, e, f, g, h, i = so3.left_jacobian_entries(x, y, z)
    return np.array(
        [
            [1.0 + (y * g - z * d), y * h - z * e, y * i - z * f, a * u + b * v + c * w],
            [z * a - x * g, 1.0 + (z * b - x * h), z * c - x * i, d * u + e * v + f * w],
            [x * d - y * a, x * e - y * b, 1.0 + (x * f - y * c), g * u + h * v + i * w],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def log(pose: Array) -> Array:
    """Tangent vector ``(..., 6)`` = (omega [rad], v [m]) of a pose ``(..., 4, 4)``."""
    omega = so3.log(pose[..., :3, :3])
    v = np.linalg.solve(so3.left_jacobian(omega), pose[..., :3, 3, None])[..., 0]
    return np.concatenate([omega, v], axis=-1)


def retract(pose: Array, xi: Array) -> Array:
    """``pose @ exp(xi)``."""
    return pose @ exp(xi)


def local(origin: Array, pose: Array) -> Array:
    """``log(inverse(origin) @ pose)``, the inverse of :func:`retract`."""
    return log(inverse(origin) @ pose)


def transform(pose: Array, points: Array) -> Array:
    """Points ``(..., n, 3)`` taken by a pose ``(..., 4, 4)`` from its inner frame to its outer one."""
    return points @ np.swapaxes(pose[..., :3, :3], -1, -2) + pose[..., None, :3, 3]


def adjoint(pose: Array) -> Array:
    """Adjoint ``(..., 6, 6)``: ``T @ exp(xi) == exp(adjoint(T) @ xi) @ T``, in the order (omega, v)."""
    rotation = pose[..., :3, :3]
    out = np.zeros((*pose.shape[:-2], 6, 6))
    out[..., :3, :3] = rotation
    out[..., 3:, 3:] = rotation
    out[..., 3:, :3] = so3.hat(pose[..., :3, 3]) @ rotation
    return out


def small_adjoint(xi: Array) -> Array:
    """Adjoint of the algebra ``(..., 6, 6)``: ``small_adjoint(x) @ y == [x, y]``, in the order (omega, v)."""
    out = np.zeros((*xi.shape, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = so3.hat(xi[..., :3])
    out[..., 3:, :3] = so3.hat(xi[..., 3:])
    return out


def left_jacobian(xi: Array) -> Array:
    """Left Jacobian of :func:`exp`, ``(..., 6)`` to ``(..., 6, 6)``.

    Barfoot, *State Estimation for Robotics* (2017), eqs. (7.85b) and (7.86b), with the blocks
    exchanged because our tangent vectors start with the rotation.
    """
    if xi.ndim == 1:
        return _left_jacobian_of_one(xi)
    omega, v = xi[..., :3], xi[..., 3:]
    angle = np.linalg.norm(omega, axis=-1)
    w, p = so3.hat(omega), so3.hat(v)
    wp, pw = w @ p, p @ w
    wpw = wp @ w
    second = so3.sine_coefficient(angle)
    third, fifth = _third_coefficient(angle), _fifth_coefficient(angle)
    coupling = (
        0.5 * p
        + second[..., None, None] * (wp + pw + wpw)
        + third[..., None, None] * (w @ wp + pw @ w - 3.0 * wpw)
        + fifth[..., None, None] * (wpw @ w + w @ wpw)
    )
    rotation = so3.left_jacobian(omega)
    out = np.zeros((*xi.shape, 6))
    out[..., :3, :3] = rotation
    out[..., 3:, 3:] = rotation
    out[..., 3:, :3] = coupling
    return out


def _left_jacobian_of_one(xi: Array) -> Array:
    """Left Jacobian of a single tangent vector, its products of cross-product matrices multiplied out.

    With ``s = omega . v``, ``a = |omega|`` and the coefficients c2, c3, c5 the coupling block is

        hat((1/2 - c3 a^2) v + s (2 c3 - c2) omega) + c2 (omega v^T + v omega^T) - 2 s c5 omega omega^T
            + 2 s (c5 a^2 - c2) 1.
    """
    x, y, z, u, v, w = xi.tolist()
    square, s = x * x + y * y + z * z, x * u + y * v + z * w
    angle = math.sqrt(square)
    second = so3.sine_coefficient_of_one(angle)
    third, fifth = _third_coefficient_of_one(angle), _fifth_coefficient_of_one(angle)
    a, b, c, d, e, f, g, h, i = so3.left_jacobian_entries(x, y, z)
    by_v, by_omega = 0.5 - third * square, s * (2.0 * third - second)
    p, q, r = by_v * u + by_omega * x, by_v * v + by_omega * y, by_v * w + by_omega * z
    # The symmetric part is the product of omega with (l, m, n) and the transpose of that product.
    half = -s * fifth
    l, m, n = second * u + half * x, second * v + half * y, second * w + half * z  # noqa: E741
    own = 2.0 * s * (fifth * square - second)
    xy, xz, yz = x * m + y * l, x * n + z * l, y * n + z * m
    return np.array(
        [
            [a, b, c, 0.0, 0.0, 0.0],
            [d, e, f, 0.0, 0.0, 0.0],
            [g, h, i, 0.0, 0.0, 0.0],
            [2.0 * x * l + own, xy - r, xz + q, a, b, c],
            [xy + r, 2.0 * y * m + own, yz - p, d, e, f],
            [xz - q, yz + p, 2.0 * z * n + own, g, h, i],
        ]
    )


def right_jacobian(xi: Array) -> Array:
    """Right Jacobian: ``exp(xi + d) ~ exp(xi) @ exp(J d)``; equals ``left_jacobian(-xi)``."""
    return left_jacobian(-xi)


def _third_coefficient(angle: Array) -> Array:
    """``(a^2 + 2 cos a - 2) / (2 a^4)``, by its series near zero."""
    small = angle < _SMALL_ANGLE
    safe = np.where(small, 1.0, angle)
    closed = (safe**2 + 2.0 * np.cos(safe) - 2.0) / (2.0 * safe**4)
    square = angle**2
    return np.where(small, 1.0 / 24.0 - square / 720.0 + square**2 / 40320.0, closed)


def _fifth_coefficient(angle: Array) -> Array:
    """``(2 a - 3 sin a + a cos a) / (2 a^5)``, by its series near zero."""
    small = angle < _SMALL_ANGLE
    safe = np.where(small, 1.0, angle)
    closed = (2.0 * safe - 3.0 * np.sin(safe) + safe * np.cos(safe)) / (2.0 * safe**5)
    square = angle**2
    return np.where(small, 1.0 / 120.0 - square / 2520.0 + square**2 / 120960.0, closed)


def _third_coefficient_of_one(a: float) -> float:
    if a < _SMALL_ANGLE:
        return 1.0 / 24.0 - a**2 / 720.0 + a**4 / 40320.0
    return (a**2 + 2.0 * math.cos(a) - 2.0) / (2.0 * a**4)


def _fifth_coefficient_of_one(a: float) -> float:
    if a < _SMALL_ANGLE:
        return 1.0 / 120.0 - a**2 / 2520.0 + a**4 / 120960.0
    return (2.0 * a - 3.0 * math.sin(a) + a * math.cos(a)) / (2.0 * a**5)
