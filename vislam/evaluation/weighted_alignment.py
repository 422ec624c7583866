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


def without_motion(changes: Array, position: Array, cov: Array) -> Array:
    """Changes of positions less the rigid motion that :func:`align_weighted` takes out of each.

    To first order.

    Parameters
    ----------
    changes : (c, n, d)
        Of all positions by each of some causes [m], d = 2 or 3.
    position : (n, d)
        [m].
    cov : (n, d, d)
        The covariances of the alignment [m^2].

    Returns
    -------
    (c, n, d)
    """
    size = position.shape[1]
    off = position - position[np.argmin(np.trace(cov, axis1=1, axis2=2))]
    turns = np.stack([-off[:, 1], off[:, 0]], axis=1)[:, :, None] if size == 2 else -so3.hat(off)
    motion = np.concatenate([np.broadcast_to(np.eye(size), (len(off), size, size)), turns], axis=2)
    factor = np.linalg.inv(np.linalg.cholesky(cov))
    rows = (factor @ motion).reshape(-1, motion.shape[2])
    whitened = np.einsum("nij,cnj->cni", factor, changes).reshape(len(changes), rows.shape[0])
    taken = np.linalg.lstsq(rows, whitened.T, rcond=None)[0]
    return np.asarray(changes - np.einsum("nij,jc->cni", motion, taken))
