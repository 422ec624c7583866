"""The filter's update under the robust kernel: iterated reweighting to a fixed point."""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from vislam.base.types import Array
from vislam.models.kernel import DIMENSION, Kernel

_CONVERGED = 1e-6
"""Reweighting ends when no weight changes by more than this share of itself."""
MOST = 100
"""Steps of reweighting, at most."""


def student_weights(
    kernel: Kernel, spread: Array, variance: Array, innovation: Array, *, first: Array
) -> tuple[Array, bool]:
    r"""Weights of the observations of an update at the mode of the posterior under a kernel.

    Of an error x with covariance P and observations ``innovation = H x + r`` the most probable x minimises

        x^T P^-1 x / 2 + sum_i rho(d_i^2),    d_i^2 = r_i^T R_i^-1 r_i,

    where ``rho(d^2) = (nu + 3) / 2 log(1 + d^2 / nu)``. Its gradient vanishes where

        P^-1 x = H^T R_w^-1 (innovation - H x),    R_w = blockdiag(R_i / w_i),    w_i = 2 rho'(d_i^2),

    which is the linear update with the noise R_w, the weights being those of the residuals *after* it. By
    ``S_w = H P H^T + R_w`` these residuals are

        innovation - H x = R_w S_w^-1 innovation,

    so the weights are found before any gain is. As rho is concave in d^2, each step majorises the sum by the
    quadratic that touches it at the residuals so far, and never raises it: it is the EM algorithm for the
    Student density (Lange, Little and Taylor, JASA 84, 1989). A smoother whose factors have the same kernel
    minimises the same sum over all frames; so the two have the same weights for the same residuals, and
    differ in what residuals they have: a filter's are those at their own frame, and are not re-weighted by
    what comes later.

    Parameters
    ----------
    kernel : Kernel
    spread : (3n, 3n)
        ``H P H^T`` [px^2].
    variance : (n, 3)
        R, the noise without a kernel [px^2].
    innovation : (3n,)
        [px].
    first : (n,)
        Weights to start from.

    Returns
    -------
    weights : (n,)
    converged : bool
        Whether they had converged after :data:`MOST` steps.
    """
    weights = first
    diagonal = np.arange(len(innovation))
    for _ in range(MOST):
        noise = (variance / weights[:, None]).reshape(-1)
        total = spread.copy()
        total[diagonal, diagonal] += noise
        residual = noise * cho_solve(cho_factor(total, lower=True, overwrite_a=True), innovation)
        before, weights = weights, kernel.weight(_squared(residual, variance))
        if np.all(np.abs(weights - before) <= _CONVERGED * before):
            return weights, True
    return weights, False


def _squared(residual: Array, variance: Array) -> Array:
    """Squared norms ``(n,)`` of residuals ``(3n,)`` whitened by their noise ``(n, 3)``."""
    return np.asarray(np.sum(residual.reshape(-1, DIMENSION) ** 2 / variance, axis=1))
