"""Proper scoring rules of what is claimed: they reward errors that are small and covariances that are true.

The NEES alone does not: an estimate that is uncertain of everything has a NEES near 1 as well. Of a proper
score the truth itself has the best expectation (Gneiting and Raftery, *Strictly Proper Scoring Rules,
Prediction, and Estimation*, JASA 2007).
"""

import numpy as np

from vislam.base.types import Array

_DRAWS = 256
"""Draws of the energy score: its error is some 3 % of one standard deviation a pose, less in the mean."""
_MOST_AT_ONCE = 4096


def log_score(whitened: Array, factor: Array) -> Array:
    """Negative log-density ``(n,)`` of errors under what was claimed [nats]; less is better.

    ``(e^T P^-1 e + log det P + d log 2 pi) / 2``; the unit of ``e`` is in it, so only the same quantity is to
    be compared.

    Parameters
    ----------
    whitened : (n, d)
        ``L^-1 e``.
    factor : (n, d, d)
        ``L``, the Cholesky factor of the claimed covariance ``P``.
    """
    size = whitened.shape[1]
    volume = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    return np.asarray(0.5 * np.sum(whitened**2, axis=1) + volume + 0.5 * size * np.log(2.0 * np.pi))


def energy_score(whitened: Array, factor: Array) -> Array:
    """Energy score ``(n,)`` of errors under what was claimed, in their unit; less is better.

    ``E |X - e| - E |X - X'| / 2`` with independent X, X' of the claimed distribution (Gneiting and Raftery,
    eq. 21 with beta = 1). ``X - X'`` is distributed as ``sqrt(2) X``. The expectations are over the same
    draws for every pose, so that scores of two trajectories differ by nothing else.

    Parameters
    ----------
    whitened, factor
        As for :func:`log_score`.
    """
    # Each with its opposite: the mean of the draws is then that of the distribution.
    draws = np.random.default_rng(0).standard_normal((_DRAWS // 2, whitened.shape[1]))
    products = (draws[:, :, None] * draws[:, None, :]).reshape(len(draws), -1)
    found = np.empty(len(whitened))
    for start in range(0, len(whitened), _MOST_AT_ONCE):
        rows = slice(start, start + _MOST_AT_ONCE)
        gram = factor[rows].transpose(0, 2, 1) @ factor[rows]
        toward = (gram @ whitened[rows, :, None])[:, :, 0]
        # Squares of a draw, of what was erred, and twice their product.
        drawn = gram.reshape(len(gram), -1) @ products.T
        erred = np.sum(whitened[rows] * toward, axis=1)
        mixed = 2.0 * toward @ draws.T
        apart = sum(_root(drawn + erred[:, None] + sign * mixed).mean(axis=1) for sign in (-1.0, 1.0))
        found[rows] = 0.5 * apart - _root(drawn).mean(axis=1) / np.sqrt(2.0)
    return found


def _root(squares: Array) -> Array:
    """Root of sums of squares that rounding may have taken below 0."""
    return np.asarray(np.sqrt(np.maximum(squares, 0.0)))
