"""Curves through measured times."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from vislam.base.types import Array

_DEGREE = 3


@dataclass(frozen=True)
class Polynomial:
    """A polynomial without negative coefficients, fitted to times by their relative differences.

    Attributes
    ----------
    coefficients : (4,)
        Constant first [s].
    residual : float
        Root mean square of the relative differences.
    """

    coefficients: Array
    residual: float

    @classmethod
    def through(cls, at: Array, time: Array) -> "Polynomial":
        """Fit times ``(n,)`` at sizes ``(n,)``."""
        largest = float(at.max())
        powers = np.vander(at / largest, _DEGREE + 1, increasing=True) / time[:, None]
        scaled, _ = nnls(powers, np.ones(len(at)))
        residual = float(np.sqrt(np.mean((powers @ scaled - 1.0) ** 2)))
        return cls(scaled / largest ** np.arange(_DEGREE + 1), residual)

    def __call__(self, at: Array) -> Array:
        """Times at sizes."""
        return np.asarray(np.vander(at, _DEGREE + 1, increasing=True) @ self.coefficients)


def exponent(at: Array, time: Array) -> float:
    """Exponent of the power law through times ``(n,)`` at sizes ``(n,)``."""
    return float(np.polyfit(np.log(at), np.log(time), 1)[0])
