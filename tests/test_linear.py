"""Systems whose unknowns differ in size by many orders of magnitude."""

import numpy as np
import pytest

from vislam.base import linear


def test_solution_and_inverse_are_those_of_the_matrix(rng):
    root = rng.standard_normal((4, 5, 5))
    matrix, right = root @ root.transpose(0, 2, 1), rng.standard_normal((4, 5))
    assert np.allclose(np.einsum("nij,nj->ni", matrix, linear.solve(matrix, right)), right, atol=1e-6)
    assert np.allclose(matrix @ linear.inverse(matrix), np.eye(5), atol=1e-6)


@pytest.mark.parametrize("size", [1e-30, 1e30])
def test_sizes_do_not_matter(size):
    matrix = np.array([[1.0, 0.5 * size], [0.5 * size, size**2]])
    found = linear.solve(matrix, np.array([1.0, 0.5 * size])) * [1.0, size]
    assert np.allclose(found, [1.0, 0.0], atol=1e-9)


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.ones((3, 3)), np.diag([1.0, 0.0, 4.0])])
def test_what_is_not_told_stays_finite(matrix):
    assert np.isfinite(linear.solve(matrix, np.zeros(3))).all()
    cov = linear.inverse(matrix)
    sigma = np.sqrt(np.diagonal(cov))
    assert np.isfinite(cov / np.outer(sigma, sigma)).all()
