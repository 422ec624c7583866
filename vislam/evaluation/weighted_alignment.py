"""Rigid alignment of positions that are not all equally certain."""

import numpy as np
from scipy.optimize import least_squares

from vislam.base.types import Array
from vislam.evaluation.alignment import align
from vislam.geometry import so3


def align_weighted(target: Array, estimate: Array, cov: Array) -> Array:
    """Target positions, moved rigidly to where the squared Mahalanobis distances to an estimate are least.

    Parameters
    ----------
    target, estimate : (n, d)
        Matched positions [m], d = 2 or 3.
    cov : (n, d, d)
        Covariances of the estimate, in its axes [m^2].

    Returns
    -------
    (n, d)
        In the axes of the estimate.
    """
    size = estimate.shape[1]
    turns = 1 if size == 2 else 3
    rotation, translation = align(target, estimate)
    start = target @ rotation.T + translation
    # What is most certain is the centre of the turns: there the search must move least.
    centre = start[np.argmin(np.trace(cov, axis1=1, axis2=2))]
    factor = np.linalg.inv(np.linalg.cholesky(cov))

    def moved(motion: Array) -> Array:
        omega = np.zeros(3)
        omega[-turns:] = motion[size:]
        turn = so3.exp(omega)[:size, :size]
        return np.asarray((start - centre) @ turn.T + centre + motion[:size])

    def residuals(motion: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", factor, moved(motion) - estimate).ravel())

    return moved(least_squares(residuals, np.zeros(size + turns), x_scale="jac").x)
