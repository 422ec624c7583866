"""Rigid alignment of an estimated trajectory with a reference."""

import numpy as np

from vislam.types import Array


def align(estimate: Array, reference: Array) -> tuple[Array, Array]:
    """Least-squares rigid motion from estimate to reference, in two or three dimensions.

    Umeyama (PAMI 1991), eqs. (40) to (42) without scale.

    Parameters
    ----------
    estimate, reference : (n, d)
        Matched positions [m], d = 2 or 3.

    Returns
    -------
    rotation : (d, d)
    translation : (d,)
        ``reference ~ estimate @ rotation.T + translation``.
    """
    centre, target = estimate.mean(axis=0), reference.mean(axis=0)
    u, _, vt = np.linalg.svd((reference - target).T @ (estimate - centre))
    sign = np.eye(estimate.shape[1])
    sign[-1, -1] = np.sign(np.linalg.det(u @ vt))
    rotation = u @ sign @ vt
    return rotation, target - rotation @ centre
