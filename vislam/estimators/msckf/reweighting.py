"""The update under the robust kernel: iterated reweighting of the observations of ended tracks."""

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from vislam.base.types import Array, BoolArray
from vislam.estimators.msckf.projection import Constraints, Projected, eliminate
from vislam.models.kernel import DIMENSION, Kernel

_CONVERGED = 1e-6
"""Reweighting ends when no weight changes by more than this share of itself."""
MOST = 100
"""Steps of reweighting, at most."""


def student(kernel: Kernel, constraints: Constraints, seen: BoolArray, cov: Array) -> tuple[Projected, bool]:
    """Tracks with the weights of their observations at the mode of the posterior under a kernel.

    The most probable error x of the state, of covariance P, and the landmarks' f minimise

        x^T P^-1 x / 2 + sum_i rho(|r_i - H_x,i x - H_f,i f|^2),

    the sum being over single observations. Where its gradient vanishes, x and f are those of the linear
    problem with the weights ``w_i = 2 rho'`` of their own residuals, so the weights are iterated to that
    fixed point, as the EKF does without landmarks to eliminate (:mod:`vislam.estimators.ekf.reweighting`,
    with why no step raises the sum). As the weights turn the null space of H_f, landmarks are eliminated in
    each step.

    Parameters
    ----------
    kernel : Kernel
    constraints : Constraints
    seen : (n, V)
    cov : (d, d)

    Returns
    -------
    projected : Projected
        With the weights.
    converged : bool
        Whether they had converged after :data:`MOST` steps.
    """
    weight = _weights(kernel, constraints.residual, seen)
    for _ in range(MOST):
        projected = eliminate(constraints, weight)
        left = projected.smoothed_residuals(_error(projected, cov))
        root = np.sqrt(np.repeat(np.where(seen, weight, 1.0), DIMENSION, axis=1))
        before, weight = weight, _weights(kernel, left / root, seen)
        if np.all(np.abs(weight - before) <= _CONVERGED * before):
            return eliminate(constraints, weight), True
    return eliminate(constraints, weight), False


def _weights(kernel: Kernel, residual: Array, seen: BoolArray) -> Array:
    """Weights ``(n, V)`` of observations with whitened residuals ``(n, 3V)``; 0 where there is none."""
    squared = np.sum(residual.reshape(*seen.shape, DIMENSION) ** 2, axis=2)
    return np.where(seen, kernel.weight(squared), 0.0)


def _error(projected: Projected, cov: Array) -> Array:
    """Most probable error ``(d,)`` of the state for given weights: ``P H^T (H P H^T + 1)^-1 r``."""
    jacobian, residual, _ = projected.stacked()
    gain = jacobian @ cov
    spread = gain @ jacobian.T
    spread.reshape(-1)[:: len(spread) + 1] += 1.0
    return np.asarray(cho_solve(cho_factor(spread, lower=True, overwrite_a=True), residual) @ gain)
