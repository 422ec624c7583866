"""Every sentence of the conventions page, and the Jacobians, against GTSAM, SciPy and finite differences."""

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from vislam.geometry import se3, so3

SIZES = [1e-9, 1e-4, 0.03, 0.06, 1.0, 3.0]


def numerical(function, at, *, step=1e-6):
    columns = [(function(at + step * e) - function(at - step * e)) / (2 * step) for e in np.eye(len(at))]
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("size", SIZES)
def test_exponential_is_gtsams_and_scipys(rng, size):
    for xi in size * rng.uniform(-1, 1, (20, 6)) / np.sqrt(3):
        assert np.allclose(se3.exp(xi), gtsam.Pose3.Expmap(xi).matrix(), atol=1e-12)
        assert np.allclose(se3.exp(xi), RigidTransform.from_exp_coords(xi).as_matrix(), atol=1e-12)


@pytest.mark.parametrize("size", [*SIZES, 3.14159])
def test_logarithm_inverts_the_exponential(rng, size):
    direction = rng.normal(size=(20, 3))
    omega = size * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    xi = np.concatenate([omega, rng.normal(size=(20, 3))], axis=1)
    assert np.allclose(se3.exp(se3.log(se3.exp(xi))), se3.exp(xi), atol=1e-9)


def test_retract_and_local_are_gtsams(rng):
    one, other, xi = se3.exp(rng.normal(size=6)), se3.exp(rng.normal(size=6)), rng.normal(size=6)
    assert np.allclose(se3.retract(one, xi), gtsam.Pose3(one).retract(xi).matrix())
    assert np.allclose(
        se3.local(one, other), gtsam.Pose3.Logmap(gtsam.Pose3(one).between(gtsam.Pose3(other)))
    )


def test_adjoint_moves_a_perturbation_across(rng):
    pose, xi = se3.exp(rng.normal(size=6)), 0.1 * rng.normal(size=6)
    assert np.allclose(pose @ se3.exp(xi), se3.exp(se3.adjoint(pose) @ xi) @ pose)
    assert np.allclose(se3.adjoint(pose), gtsam.Pose3(pose).AdjointMap())


@pytest.mark.parametrize("size", SIZES)
def test_right_jacobian_is_the_derivative_of_the_exponential(rng, size):
    xi = size * rng.normal(size=6) / np.sqrt(3)
    expected = numerical(lambda x: se3.local(se3.exp(xi), se3.exp(x)), xi)
    assert np.allclose(se3.right_jacobian(xi), expected, atol=1e-8)


def test_series_and_closed_form_meet(rng):
    direction = rng.normal(size=6)
    direction /= np.linalg.norm(direction[:3])
    for angle in (1e-3, 5e-2):
        below, above = (se3.left_jacobian(angle * (1 + eps) * direction) for eps in (-1e-9, 1e-9))
        assert np.allclose(below, above, atol=1e-10)


@pytest.mark.parametrize("size", [0.0, *SIZES, 3.1])
def test_one_alone_is_what_it_is_in_a_stack(rng, size):
    """Single elements are computed without arrays, stacks with them; neither is made of the other."""
    xi = rng.normal(size=(200, 6))
    xi[:, :3] *= size / np.linalg.norm(xi[:, :3], axis=1, keepdims=True)
    pose = se3.exp(xi)
    for function, stack in [
        (so3.exp, xi[:, :3]),
        (so3.left_jacobian, xi[:, :3]),
        (se3.exp, xi),
        (se3.left_jacobian, xi),
        (se3.inverse, pose),
        (se3.adjoint, pose),
    ]:
        alone = np.array([function(one) for one in stack])
        assert np.abs(alone - function(stack)).max() < 4e-15 * max(1.0, np.abs(alone).max())


def test_names_cancel_and_points_move_outwards(rng):
    a_T_b, b_T_c = se3.exp(rng.normal(size=(2, 6)))
    points_c = rng.normal(size=(4, 3))
    assert np.allclose(
        se3.transform(a_T_b @ b_T_c, points_c), se3.transform(a_T_b, se3.transform(b_T_c, points_c))
    )
    assert np.allclose(se3.inverse(a_T_b) @ a_T_b, np.eye(4))


def test_hat_is_the_cross_product(rng):
    a, b = rng.normal(size=(2, 5, 3))
    assert np.allclose(np.einsum("nij,nj->ni", so3.hat(a), b), np.cross(a, b))


@pytest.mark.parametrize("broken", [1.0, 1e-3, 2.0, np.nan, np.inf, 1e200])
def test_one_matrix_is_as_far_from_a_rotation_as_in_a_stack(rng, broken):
    """Each of its entries, one after the other, is off."""
    for entry in range(9):
        matrix = so3.exp(rng.normal(size=3))
        matrix.flat[entry] *= broken
        with np.errstate(over="ignore", invalid="ignore"):
            expected = so3.defect(matrix[None])
        for one, many in zip(so3.defect(matrix), expected, strict=True):
            assert one.shape == ()
            assert np.allclose(one, many[0], rtol=1e-12, atol=1e-15, equal_nan=True)
    assert broken != 1.0 or so3.defect(matrix)[0] < 1e-15


def test_the_smallest_rotation_from_one_direction_to_another(rng):
    for one, other in [*rng.normal(size=(5, 2, 3)), (np.eye(3)[2], -np.eye(3)[2]), (np.ones(3), np.ones(3))]:
        turn = so3.onto(one, other)
        assert np.allclose(turn @ one / np.linalg.norm(one), other / np.linalg.norm(other))
        between = np.arccos(np.clip(one @ other / np.linalg.norm(one) / np.linalg.norm(other), -1.0, 1.0))
        assert np.isclose(np.linalg.norm(so3.log(turn)), between)


def test_an_empty_stack_has_an_empty_logarithm():
    assert so3.log(np.empty((0, 3, 3))).shape == (0, 3)
    assert se3.log(np.empty((0, 4, 4))).shape == (0, 6)
