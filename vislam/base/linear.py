"""Linear systems whose unknowns have sizes of their own."""

import numpy as np

from vislam.base.types import Array

_LEAST = 1e-12
"""Information, beside 1, that each unknown has after scaling."""
_NOTHING = 1e-290
"""Information where data say nothing; the variance, ``1 / (_LEAST * _NOTHING)``, is finite."""


def scaled(information: Array) -> tuple[Array, Array]:
    """Matrices ``(..., d, d)`` with ones on the diagonal, not singular, and the scales ``(..., d)``.

    Of an unknown that is known 1e10 times better than another, next to nothing would be left of the other by
    rounding; scaled, they stand side by side.
    """
    scale = np.sqrt(np.maximum(np.diagonal(information, axis1=-2, axis2=-1), _NOTHING))
    one = information / scale[..., :, None] / scale[..., None, :]
    return one + _LEAST * np.eye(information.shape[-1]), scale


def solve(information: Array, right: Array) -> Array:
    """Solution ``(..., d)`` of information matrices ``(..., d, d)`` and right sides ``(..., d)``."""
    matrix, scale = scaled(information)
    return np.asarray(np.linalg.solve(matrix, (right / scale)[..., None])[..., 0] / scale)


def inverse(information: Array) -> Array:
    """Covariances ``(..., d, d)`` of information matrices."""
    matrix, scale = scaled(information)
    return np.asarray(np.linalg.inv(matrix) / scale[..., :, None] / scale[..., None, :])
