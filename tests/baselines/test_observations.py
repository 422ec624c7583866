"""What is seen of points, and how it changes with pose and point."""

import numpy as np
import pytest

from vislam.comparison.open import Dataset
from vislam.geometry import se3
from vislam.models import StereoRig
from vislam_baselines.observations import look, pixel_variances

RIG = StereoRig(500.0, 480.0, 320.0, 200.0, 0.5, se3.exp(np.array([0.1, -0.2, 0.3, 0.4, 0.5, 0.6])))


@pytest.fixture
def scene(rng):
    """A pose and points in front of its camera."""
    pose = se3.exp(rng.normal(size=6))
    points_cam = np.column_stack([rng.uniform(-5, 5, (8, 2)), rng.uniform(6, 30, 8)])
    return pose, points_cam, se3.transform(pose @ RIG.imu_T_cam, points_cam)


def slope(function, step=1e-6):
    return (function(step) - function(-step)) / (2.0 * step)


def test_a_point_is_seen_where_it_projects(scene):
    pose, points_cam, points_world = scene
    seen = look(RIG, pose, points_world)
    assert seen.z == pytest.approx(RIG.project(points_cam), abs=1e-9)
    assert seen.depth == pytest.approx(points_cam[:, 2], abs=1e-12)


def test_derivatives_are_those_of_finite_differences(scene):
    pose, _, points = scene
    seen = look(RIG, pose, points)
    for axis in range(6):
        moved = slope(lambda h, axis=axis: look(RIG, se3.retract(pose, h * np.eye(6)[axis]), points).z)
        assert seen.by_pose[:, :, axis] == pytest.approx(moved, abs=1e-4)
        assert np.abs(moved).max() > 1.0
    for axis in range(3):
        moved = slope(lambda h, axis=axis: look(RIG, pose, points + h * np.eye(3)[axis]).z)
        assert seen.by_point[:, :, axis] == pytest.approx(moved, abs=1e-4)


def test_the_mean_row_has_half_the_variance_of_a_pixel_coordinate(short: Dataset):
    sigma = np.full((short.sequence.observations, 3), 0.7)
    frame = next(short.sequence.frames(sigma))
    assert np.allclose(pixel_variances(frame, 3.0), [3.0, 3.0, 1.5])
    assert np.allclose(pixel_variances(frame, None), 0.49)
