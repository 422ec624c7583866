"""Linear factors of any number of variables, exactly, of GTSAM's of three at most."""

from collections.abc import Mapping
from typing import Any

import gtsam
import numpy as np

from vislam.base.types import Array

_MOST = 3
"""Variables of a factor that can be made from Python."""


def linear_factor(
    terms: Mapping[int, Array], right: Array, sigma: Array, *, at: gtsam.Values | None = None
) -> gtsam.NonlinearFactor:
    """Factor ``sum_i A_i (x_i - a_i) = right`` within ``sigma (m,)``.

    Parameters
    ----------
    terms : mapping of int to (m, n)
        ``A_i`` by the keys of the variables.
    right, sigma : (m,)
    at : gtsam.Values, optional
        Where the a_i are; by default 0, of vectors.
    """
    if at is None:
        at = gtsam.Values()
        for key, matrix in terms.items():
            at.insert(key, np.zeros(matrix.shape[1]))
    return gtsam.LinearContainerFactor(_joined(dict(terms), right, sigma), at)


def _joined(terms: dict[int, Array], right: Array, sigma: Array) -> gtsam.JacobianFactor:
    """Linear factor of vectors, of more than three in links ``y_i`` of a chain that are eliminated again.

    A link splits the noise in two: of ``y - f = n_1`` and ``y + g = b + n_2``, with y unknown, ``f + g = b``
    is left, within the sum of both variances.
    """
    if len(terms) <= _MOST:
        return _jacobian(terms, right, sigma)
    items, size = list(terms.items()), len(right)
    links = len(items) - _MOST
    part = np.asarray(sigma) / np.sqrt(links + 1.0)
    chain, held, order = gtsam.GaussianFactorGraph(), dict(items[:2]), gtsam.Ordering()
    for index, item in enumerate(items[2 : 2 + links]):
        link = gtsam.symbol("z", index)
        chain.add(_jacobian({link: -np.eye(size), **held}, np.zeros(size), part))
        held = {link: np.eye(size), item[0]: item[1]}
        order.push_back(link)
    chain.add(_jacobian({**held, items[-1][0]: items[-1][1]}, right, part))
    joined: Any = gtsam.JacobianFactor
    return joined(chain).eliminate(order)[1]


def _jacobian(terms: Mapping[int, Array], right: Array, sigma: Array) -> gtsam.JacobianFactor:
    blocks = [part for term in terms.items() for part in term]
    made: Any = gtsam.JacobianFactor
    return made(*blocks, right, gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigma, float)))
