"""The robust kernel of the tracks: one density of the pixel errors, for filters and smoothers alike.

An observation ``z = (uL, uR, v)`` with residual r and standard deviations sigma has the squared norm ``d^2 =
sum_i (r_i / sigma_i)^2``. With a kernel its error has Student's density of nu degrees of freedom in place of
the Gaussian,

    -log p(r) = (nu + 3) / 2  log(1 + d^2 / nu) + const,

whose gradient is that of ``w d^2 / 2`` with

    w(d^2) = (nu + 3) / (nu + d^2)

held fixed (Lange, Little and Taylor, *Robust statistical modeling using the t distribution*, JASA 84, 1989):
the noise has ``1 / w`` of its variance. An observation whose residual is of the size that is expected, ``d^2
= 3``, keeps its noise.

Cauchy's kernel of threshold k on residuals of standard deviations ``s sigma`` weighs by ``1 / (1 + d^2 / (s
k)^2) / s^2``: with ``k^2 = nu + 3`` and ``s^2 = nu / (nu + 3)`` that is the same function.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array

DIMENSION = 3
"""Numbers of an observation: uL, uR, v."""


@dataclass(frozen=True)
class Kernel:
    """Student's density of the pixel errors.

    Attributes
    ----------
    degrees_of_freedom : float
        nu: the smaller, the heavier are the tails; the Gaussian is its limit.
    """

    degrees_of_freedom: float

    def weight(self, squared: Array) -> Array:
        """Weights ``(n,)`` of observations with squared whitened residuals ``(n,)``."""
        nu = self.degrees_of_freedom
        return (nu + DIMENSION) / (nu + squared)

    def loss(self, squared: Array) -> Array:
        """Twice the negative logarithm of the density, but for a constant, of squared norms ``(n,)``."""
        nu = self.degrees_of_freedom
        return (nu + DIMENSION) * np.log1p(squared / nu)

    @property
    def cauchy(self) -> tuple[float, float]:
        """Threshold k of Cauchy's kernel that is the same, and the factor s on the standard deviations."""
        nu = self.degrees_of_freedom
        return float(np.sqrt(nu + DIMENSION)), float(np.sqrt(nu / (nu + DIMENSION)))

    def __str__(self) -> str:
        """Name for tables and for what runs state of themselves."""
        return f"Student, {self.degrees_of_freedom:g} degrees of freedom"


def kernel_name(kernel: Kernel | None) -> str:
    """How an estimator states its kernel, the same for all that have the same one."""
    return "none" if kernel is None else str(kernel)
