"""Rotations: hat, exponential, logarithm and the Jacobians of the exponential, all in batch form."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.base.types import Array

_SMALL_ANGLE = 1e-3
"""Below this angle [rad] the coefficients come from their series: there the closed forms lose digits."""

_GENERATORS = np.zeros((3, 9))
"""Cross-product matrices of the three axes, row after row."""
_GENERATORS[0, [7, 5]] = _GENERATORS[1, [2, 6]] = _GENERATORS[2, [3, 1]] = [1.0, -1.0]


def hat(omega: Array) -> Array:
    """Cross-product matrix of a vector.

    Parameters
    ----------
    omega : (..., 3)

    Returns
    -------
    (..., 3, 3), with ``hat(a) @ b == cross(a, b)``.
    """
    if omega.ndim == 1:
        x, y, z = omega.tolist()
        return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return (omega @ _GENERATORS).reshape(*omega.shape, 3)


def exp(omega: Array) -> Array:
    """Rotation matrix ``(..., 3, 3)`` of a rotation vector ``(..., 3)`` [rad], by Rodrigues' formula."""
    if omega.ndim == 1:
        return _exp_of_one(*omega.tolist())
    angle = np.linalg.norm(omega, axis=-1)
    matrix = hat(omega)
    first, second = np.sinc(angle / np.pi), cosine_coefficient(angle)
    return np.eye(3) + first[..., None, None] * matrix + second[..., None, None] * (matrix @ matrix)


def _exp_of_one(x: float, y: float, z: float) -> Array:
    """Rotation matrix of a single vector, which filters ask for at each step, without an array on the way."""
    angle = math.sqrt(x * x + y * y + z * z)
    first = math.sin(angle) / angle if angle > 0.0 else 1.0
    return np.array(_entries(x, y, z, first, cosine_coefficient_of_one(angle))).reshape(3, 3)


def _entries(x: float, y: float, z: float, first: float, second: float) -> tuple[float, ...]:
    """Entries of ``1 + first hat + second hat^2``, row after row, hat being that of (x, y, z)."""
    xx, yy, zz = x * x, y * y, z * z
    xy, xz, yz = second * x * y, second * x * z, second * y * z
    x, y, z = first * x, first * y, first * z
    return (
        1.0 - second * (yy + zz),
        xy - z,
        xz + y,
        xy + z,
        1.0 - second * (xx + zz),
        yz - x,
        xz - y,
        yz + x,
        1.0 - second * (xx + yy),
    )


def log(rotation: Array) -> Array:
    """Rotation vector ``(..., 3)`` [rad], of angle at most pi, of a matrix ``(..., 3, 3)``."""
    if not rotation.size:
        # SciPy before 1.15 takes no empty stack.
        return np.empty(rotation.shape[:-1])
    vectors: Array = Rotation.from_matrix(rotation.reshape(-1, 3, 3)).as_rotvec()
    return vectors.reshape(rotation.shape[:-1])


def onto(one: Array, other: Array) -> Array:
    """Smallest rotation ``(3, 3)`` that takes the direction of a vector ``(3,)`` to that of another."""
    axis = np.cross(one, other)
    sine, cosine = float(np.linalg.norm(axis)), float(one @ other)
    if sine == 0.0 and cosine < 0.0:
        # Opposite: half a turn about any axis across.
        axis = np.cross(one, np.eye(3)[np.argmin(np.abs(one))])
        return exp(np.pi * axis / np.linalg.norm(axis))
    return exp(axis * (np.arctan2(sine, cosine) / sine)) if sine > 0.0 else np.eye(3)


def defect(matrix: Array) -> tuple[Array, Array]:
    """How far matrices ``(..., 3, 3)`` are from rotations: max ``|R^T R - 1|``, and the determinant.

    The determinant is the triple product of the rows, which has no trouble with numbers next to zero.
    """
    if matrix.ndim == 2:
        return _defect_of_one(matrix.tolist())
    off = np.abs(np.swapaxes(matrix, -1, -2) @ matrix - np.eye(3)).max(axis=(-1, -2))
    normal = np.cross(matrix[..., 0, :], matrix[..., 1, :])
    return off, np.asarray(np.sum(normal * matrix[..., 2, :], axis=-1))


def _defect_of_one(rows: list[list[float]]) -> tuple[Array, Array]:
    """The same of a single matrix, as each pose that an estimator returns is looked at."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    products = (
        a * a + d * d + g * g - 1.0,
        b * b + e * e + h * h - 1.0,
        c * c + f * f + i * i - 1.0,
        a * b + d * e + g * h,
        a * c + d * f + g * i,
        b * c + e * f + h * i,
    )
    normal = b * f - c * e, c * d - a * f, a * e - b * d
    return np.asarray(np.abs(products).max()), np.asarray(normal[0] * g + normal[1] * h + normal[2] * i)


def left_jacobian(omega: Array) -> Array:
    """Left Jacobian of the exponential: ``exp(omega + d) ~ exp(J d) @ exp(omega)``.

    Barfoot, *State Estimation for Robotics* (2017), eq. (7.77); ``(..., 3)`` to ``(..., 3, 3)``.
    """
    if omega.ndim == 1:
        return np.array(left_jacobian_entries(*omega.tolist())).reshape(3, 3)
    angle = np.linalg.norm(omega, axis=-1)
    first, second = cosine_coefficient(angle), sine_coefficient(angle)
    matrix = hat(omega)
    return np.eye(3) + first[..., None, None] * matrix + second[..., None, None] * (matrix @ matrix)


def left_jacobian_entries(x: float, y: float, z: float) -> tuple[float, ...]:
    """Entries of the left Jacobian of a single vector (x, y, z) [rad], row after row."""
    angle = math.sqrt(x * x + y * y + z * z)
    return _entries(x, y, z, cosine_coefficient_of_one(angle), sine_coefficient_of_one(angle))


def cosine_coefficient_of_one(angle: float) -> float:
    """:func:`cosine_coefficient` of a single angle."""
    half = 0.5 * angle
    return 0.5 * (math.sin(half) / half) ** 2 if half > 0.0 else 0.5


def sine_coefficient_of_one(angle: float) -> float:
    """:func:`sine_coefficient` of a single angle."""
    small = angle < _SMALL_ANGLE
    return 1.0 / 6.0 - angle**2 / 120.0 if small else (angle - math.sin(angle)) / angle**3


def cosine_coefficient(angle: Array) -> Array:
    """``(1 - cos a) / a^2``, written as half a squared sine so that no digits are lost near zero."""
    return np.asarray(0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2)


def sine_coefficient(angle: Array) -> Array:
    """``(a - sin a) / a^3``, by its series near zero."""
    safe = np.where(angle < _SMALL_ANGLE, 1.0, angle)
    closed = (safe - np.sin(safe)) / safe**3
    return np.where(angle < _SMALL_ANGLE, 1.0 / 6.0 - angle**2 / 120.0, closed)
