"""Tracks as constraints: Jacobians, and landmarks that are eliminated as if marginalised without a prior."""

import numpy as np
import pytest

from tests.smoother.drives import RIG
from vislam.estimators.ekf import parametrisation
from vislam.estimators.ekf.layout import NavLayout
from vislam.estimators.ekf.measurement import Camera
from vislam.estimators.msckf import projection
from vislam.estimators.msckf.pending import Packed
from vislam.estimators.msckf.projection import Constraints, eliminate
from vislam.estimators.msckf.window import Window
from vislam.geometry import se3

STEP = 1e-6


def project(world_T_imu, points, rig=RIG):
    """Observations of points ``(n, 3)`` from poses ``(n, V, 4, 4)``."""
    in_cam = se3.transform(se3.inverse(world_T_imu @ rig.imu_T_cam), points[:, None, None])[:, :, 0]
    return rig.project(in_cam)


def views(rng, n=4, count=5):
    """Poses that move forward by about a metre each, and points in front of all of them."""
    motion = rng.normal(0.0, 0.05, (n, count, 6))
    motion[:, :, 3] += np.arange(count)
    points = np.column_stack([rng.uniform(12, 40, n), rng.uniform(-5, 5, n), rng.uniform(-2, 2, n)])
    return se3.exp(motion), points


def central(function, size):
    """Derivative by central differences, its last axis that of the variable."""
    steps = STEP * np.eye(size)
    return np.stack([(function(step) - function(-step)) / (2.0 * STEP) for step in steps], axis=-1)


def test_jacobians_are_the_finite_differences(rng):
    poses, points = views(rng)
    by_pose, by_point, depth = projection.jacobians(RIG, poses, points)
    assert (depth > RIG.nearest).all()
    numeric = central(lambda xi: project(se3.retract(poses, np.broadcast_to(xi, (4, 5, 6))), points), 6)
    assert np.allclose(by_pose, numeric, rtol=1e-6, atol=1e-4)
    assert np.allclose(by_point, central(lambda step: project(poses, points + step), 3), rtol=1e-6, atol=1e-4)


BLOCKS = {"camera_rotation": 3, "disparity_offset": 1, "principal_point": 2, "focal_scale": 1}
LAYOUT = NavLayout({"twist_bias": 6, **BLOCKS})
CAMERA = Camera(RIG, parametrisation.make("point", RIG), LAYOUT)
SHARED = np.array([0.02, -0.01, 0.015, 0.3, 2.0, -3.0, 0.01])


def window_of(poses, *, form="standard", shared=None):
    layout = LAYOUT
    nav = np.zeros(layout.size)
    if shared is not None:
        nav[layout["camera_rotation"].start :] = shared
    window = Window(layout, form, nav=nav, cov=0.01 * np.eye(layout.size))
    for _ in range(len(poses) - 1):
        window.clone()
    window.poses, window.first = poses.copy(), poses.copy()
    window.frames = np.arange(len(poses))
    return window


def packed(z, seen=None):
    n, count = z.shape[:2]
    seen = np.ones((n, count), bool) if seen is None else seen
    frame = np.where(seen, np.arange(count), 0)
    sigma = np.where(seen[:, :, None], 0.5, np.inf)
    return Packed(np.arange(n), seen, frame, z.copy(), np.broadcast_to(sigma, z.shape).copy())


def test_the_linearised_residual_follows_the_poses_and_the_shared_errors(rng):
    """The projected residual is a function of the state alone: it moves by minus H_o times an error."""
    poses, points = views(rng, n=1)
    window = window_of(poses[0], shared=SHARED)
    errors = CAMERA.errors(window.nav)
    z = project(poses, points, errors.rig(RIG)) + errors.offset
    first = LAYOUT["camera_rotation"].start
    one = np.ones((1, 5))

    def residual(error):
        moved = window_of(poses[0], shared=SHARED + error[first : LAYOUT.size])
        moved.poses = se3.retract(moved.poses, error[moved.columns[:, None] + np.arange(6)])
        found = projection.linearise(CAMERA, moved, packed(z))
        return eliminate(found, one).residual[0, 3:]

    exact = projection.linearise(CAMERA, window, packed(z))
    assert np.abs(exact.residual).max() < 1e-6
    assert np.allclose(exact.points_world, points, atol=1e-6)
    by_state = eliminate(exact, one).by_state[0, 3:]
    numeric = central(residual, len(window.cov))
    assert np.allclose(-by_state, numeric, rtol=1e-5, atol=2e-3 * np.abs(by_state).max())


def constraints(rng, n=3, count=4, d=9):
    """Any linear tracks."""
    shape = (n, 3 * count)
    return Constraints(
        rng.normal(size=(*shape, 3)),
        rng.normal(size=(*shape, d)),
        rng.normal(size=shape),
        np.zeros((n, 3)),
        np.ones(n, bool),
    )


def test_the_projection_is_the_marginal_with_no_prior_of_the_landmark(rng):
    tracks = constraints(rng)
    weight = rng.uniform(0.5, 2.0, (3, 4))
    jacobian, residual, rest = eliminate(tracks, weight).stacked()
    assert jacobian.shape == (9, 9)
    information, vector, cost = np.zeros((9, 9)), np.zeros(9), 0.0
    for j in range(3):
        w = np.diag(np.repeat(weight[j], 3))
        f, x, r = tracks.by_point[j], tracks.by_state[j], tracks.residual[j]
        left = w - w @ f @ np.linalg.inv(f.T @ w @ f) @ f.T @ w
        information += x.T @ left @ x
        vector += x.T @ left @ r
        cost += r @ left @ r
    assert np.allclose(jacobian.T @ jacobian, information, rtol=1e-10)
    assert np.allclose(jacobian.T @ residual, vector, rtol=1e-10)
    assert np.isclose(residual @ residual + rest, cost, rtol=1e-10)


def test_an_ever_weaker_prior_of_the_landmark_leads_to_it(rng):
    tracks = constraints(rng, n=1)
    jacobian, residual, _ = eliminate(tracks, np.ones((1, 4))).stacked()
    own = np.linalg.inv(np.eye(9) + jacobian.T @ jacobian)
    expected = own @ jacobian.T @ residual
    h = np.hstack([tracks.by_state[0], tracks.by_point[0]])
    for sigma, tolerance in ((1e1, 1e-1), (1e3, 1e-5), (1e5, 1e-8)):
        prior = np.diag(np.concatenate([np.ones(9), np.full(3, sigma**-2)]))
        cov = np.linalg.inv(prior + h.T @ h)
        assert np.allclose(cov[:9, :9], own, atol=tolerance)
        assert np.allclose((cov @ h.T @ tracks.residual[0])[:9], expected, atol=tolerance)


def test_residuals_after_the_update_are_those_of_the_best_landmarks(rng):
    tracks, weight, error = constraints(rng), rng.uniform(0.5, 2.0, (3, 4)), rng.normal(size=9)
    found = eliminate(tracks, weight).smoothed_residuals(error)
    for j in range(3):
        root = np.sqrt(np.repeat(weight[j], 3))
        f, left = tracks.by_point[j] * root[:, None], (tracks.residual[j] - tracks.by_state[j] @ error) * root
        assert np.allclose(found[j], left - f @ np.linalg.lstsq(f, left)[0], atol=1e-12)


def test_observations_that_are_not_there_say_nothing(rng):
    poses, points = views(rng, n=2)
    seen = np.array([[True] * 5, [True] * 3 + [False] * 2])
    z = project(np.broadcast_to(poses[:1], poses.shape), points) + rng.normal(0.0, 0.5, (2, 5, 3))
    window = window_of(poses[0])
    both = eliminate(projection.linearise(CAMERA, window, packed(z, seen)), seen.astype(float))
    short = eliminate(projection.linearise(CAMERA, window, packed(z[1:, :3])), np.ones((1, 3)))
    assert np.allclose(both.by_state[1, 3:9], short.by_state[0, 3:], atol=1e-9)
    assert not both.by_state[1, 9:].any()
    assert not both.residual[1, 9:].any()
    assert np.isclose(both.distances(window.cov)[1], short.distances(window.cov)[0], rtol=1e-9)


@pytest.mark.parametrize("form", ["fej", "invariant"])
def test_a_motion_of_the_world_is_not_seen(form, rng):
    """H N = 0 at any poses and any landmarks, if N is what the form takes the directions for."""
    poses, points = views(rng, n=1, count=4)
    noisy = se3.retract(poses, rng.normal(0.0, 0.02, (1, 4, 6)))
    window = window_of(noisy[0], form=form)
    window.first = poses[0]
    window.directions = np.zeros((len(window.cov), 6))
    for pose, column in zip(window.linearised_at, window.columns, strict=True):
        window.directions[column : column + 6] = se3.adjoint(se3.inverse(pose))
    found = eliminate(projection.linearise(CAMERA, window, packed(project(poses, points))), np.ones((1, 4)))
    seen = found.by_state[0, 3:] @ window.directions
    assert np.abs(seen).max() < 1e-9 * np.abs(found.by_state).max()


def test_a_track_without_a_depth_is_not_solved(rng):
    poses, points = views(rng, n=2, count=3)
    z = project(np.broadcast_to(poses[:1], poses.shape), points)
    z[1, :, 1] = z[1, :, 0] + [0.0, 3.0, 1.0]
    found = projection.linearise(CAMERA, window_of(poses[0]), packed(z))
    assert found.solved.tolist() == [True, False]
    assert np.isfinite(found.by_state).all()
