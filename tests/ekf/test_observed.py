"""The update in the coordinates of the observations is the other one, from forward to backward pass."""

import numpy as np
import pytest

from vislam.base.errors import DivergedError
from vislam.estimators.ekf.linear import (
    Adjoint,
    Jacobian,
    Update,
    diagonal_blocks,
    squared_distances,
    symmetric_product,
)
from vislam.estimators.ekf.observed import WORTH, ObservedUpdate

NAV, LANDMARKS = 9, 30


@pytest.fixture(params=["all landmarks", "some landmarks"])
def problem(request):
    """A covariance with large errors in common, a Jacobian, white noise and an innovation."""
    generator = np.random.default_rng(3)
    seen = np.arange(LANDMARKS)
    if request.param == "some landmarks":
        seen = np.delete(seen, [0, 7, 8, 29])
    size, n = NAV + 3 * LANDMARKS, len(seen)
    shared = 5.0 * generator.standard_normal((size, 6))
    own = generator.standard_normal((size, size)) / np.sqrt(size)
    jacobian = Jacobian(
        generator.standard_normal((3 * n, NAV)),
        np.eye(3) + 0.3 * generator.standard_normal((n, 3, 3)),
        seen if n < LANDMARKS else None,
        NAV,
    )
    variance = generator.uniform(0.1, 1.0, 3 * n)
    return shared @ shared.T + own @ own.T, jacobian, variance, generator.standard_normal(3 * n)


def both(problem):
    cov, jacobian, variance, innovation = problem
    projected = jacobian.times(cov)
    spread = jacobian.times(projected.T) + np.diag(variance)
    plain = Update.of(jacobian, projected.copy(), spread.copy(), innovation)
    return plain, ObservedUpdate.of(jacobian, projected, spread, innovation, variance=variance)


def close(found, expected):
    assert np.abs(found - expected).max() < 1e-9 * np.abs(expected).max()


def test_both_updates_are_one(problem):
    plain, observed = both(problem)
    close(observed.correction, plain.correction)
    close(observed.gain, plain.gain)
    close(observed.inverse, plain.inverse)
    close(observed.pull(), plain.pull())
    close(observed.white, plain.white)
    assert observed.nis == pytest.approx(plain.nis, rel=1e-10)
    assert observed.log_det == pytest.approx(plain.log_det, rel=1e-10)


def test_both_leave_one_covariance(problem):
    found, expected = problem[0].copy(), problem[0].copy()
    plain, observed = both(problem)
    observed.forward(found)
    plain.forward(expected)
    close(found, expected)
    assert np.abs(found - found.T).max() < 1e-13 * np.abs(found).max()
    assert np.linalg.eigvalsh(found)[0] > 0.9 * np.linalg.eigvalsh(expected)[0] > 0.0


def test_both_say_the_same_of_quantities_beside_the_state(problem):
    plain, observed = both(problem)
    rows = np.random.default_rng(4).standard_normal((12, len(problem[0]))) @ problem[0]
    found, expected = observed.tell(rows), plain.tell(rows)
    close(found.correction, expected.correction)
    close(found.left @ found.right.T, expected.left @ expected.right.T)
    close(found.rows, expected.rows)


def test_both_take_the_adjoint_back_to_one(problem):
    generator, size = np.random.default_rng(5), len(problem[0])
    root = generator.standard_normal((size, 20))
    adjoints = [Adjoint(root @ root.T, root[:, :7].copy()) for _ in range(2)]
    plain, observed = both(problem)
    expected, found = plain.back(adjoints[0]), observed.back(adjoints[1])
    close(found.information, expected.information)
    close(found.vectors, expected.vectors)


def test_distances_are_those_of_a_solver():
    generator = np.random.default_rng(7)
    root = generator.standard_normal((9, 3, 3))
    cov, variance, value = root @ root.transpose(0, 2, 1), generator.uniform(0.1, 1.0, (9, 3)), root[:, 0]
    whole = np.zeros((27, 27))
    diagonal_blocks(whole, 3)[...] = cov
    found = squared_distances(diagonal_blocks(whole, 3), variance, value)
    full = np.linalg.solve(cov + variance[:, :, None] * np.eye(3), value[:, :, None])[:, :, 0]
    assert np.allclose(found, np.sum(value * full, axis=1), rtol=1e-12)


@pytest.mark.parametrize("rows", [7, 512, 700])
def test_half_a_symmetric_product_is_all_of_it(rows):
    generator = np.random.default_rng(6)
    left = generator.standard_normal((rows, 40))
    right = left @ (root := generator.standard_normal((40, 40))) @ root.T
    close(symmetric_product(right, left), right @ left.T)


def test_it_is_taken_of_many_landmarks_of_three_coordinates_that_an_observation_shows():
    n = WORTH // 3 + 1
    by_nav, blocks = np.zeros((3 * n, NAV)), np.tile(np.eye(3), (n, 1, 1))
    assert ObservedUpdate.fits(Jacobian(by_nav, blocks, None, NAV))
    assert not ObservedUpdate.fits(Jacobian(by_nav[:30], blocks[:10], None, NAV))
    assert not ObservedUpdate.fits(Jacobian(by_nav, np.zeros((n, 3, 4)), None, NAV))
    blocks[4, 2] = 0.0
    assert not ObservedUpdate.fits(Jacobian(by_nav, blocks, None, NAV))


def test_a_lost_covariance_raises(problem):
    cov, jacobian, variance, innovation = problem
    projected = jacobian.times(cov)
    with pytest.raises(DivergedError, match="innovation covariance lost"):
        ObservedUpdate.of(
            jacobian, projected, -np.eye(len(projected)), innovation, variance=np.asarray(variance)
        )
