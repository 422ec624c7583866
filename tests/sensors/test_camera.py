"""Lenses against OpenCV's, and rectified pairs against projection."""

import numpy as np
import pytest

from tests.frontend.studio import cameras, pair
from vislam.geometry import se3
from vislam.models.camera import Camera, Lens

LENSES = [Lens.RADTAN, Lens.KANNALA_BRANDT, Lens.NONE]


@pytest.fixture
def points(rng):
    return np.column_stack([rng.uniform(-3, 3, 300), rng.uniform(-2, 2, 300), rng.uniform(4, 20, 300)])


@pytest.mark.parametrize("lens", LENSES)
def test_pixels_come_back(lens, points):
    camera = cameras(lens)[0]
    normalised = points[:, :2] / points[:, 2:]
    assert np.allclose(camera.undistort(camera.distort(normalised)), normalised, atol=1e-9)


@pytest.mark.parametrize("lens", LENSES[:2])
def test_lenses_are_opencvs(lens, points):
    cv2 = pytest.importorskip("cv2")
    camera = cameras(lens)[0]
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1.0]])
    coefficients = np.array(camera.coefficients)
    project = cv2.projectPoints if lens is Lens.RADTAN else cv2.fisheye.projectPoints
    given = points if lens is Lens.RADTAN else points[:, None]
    arguments = (given, np.zeros(3), np.zeros(3), matrix, coefficients)
    expected = np.asarray(project(*arguments)[0]).reshape(-1, 2)
    assert np.allclose(camera.distort(points[:, :2] / points[:, 2:]), expected, atol=1e-9)


def test_a_pixel_without_a_ray_is_nan():
    """Beyond the fold of the model, at a distorted radius of 0.59 of k1 = -0.28 alone, there is no ray."""
    camera = Camera(100, 100, 100.0, 100.0, 50.0, 50.0, Lens.RADTAN, (-0.8, 0.0, 0.0, 0.0))
    found = camera.undistort(np.array([[50.0, 50.0], [70.0, 50.0], [140.0, 50.0]]))
    assert np.isfinite(found[:2]).all()
    assert np.isnan(found[2]).all()


def test_a_wrong_number_of_coefficients_is_refused():
    with pytest.raises(ValueError, match="coefficients of kannala_brandt must be 4 numbers, got 2"):
        Camera(10, 10, 5.0, 5.0, 5.0, 5.0, Lens.KANNALA_BRANDT, (0.1, 0.2))


@pytest.mark.parametrize("lens", LENSES)
def test_rectified_pixels_are_those_of_the_rig(lens, points):
    left, right, imu_T_left, imu_T_right = cameras(lens)
    made = pair(lens)
    body = se3.transform(imu_T_left, points)
    raw = []
    for camera, imu_T_cam in ((left, imu_T_left), (right, imu_T_right)):
        seen = se3.transform(se3.inverse(imu_T_cam), body)
        raw.append(camera.distort(seen[:, :2] / seen[:, 2:]))
    expected = made.rig.project(se3.transform(made.rig.cam_T_imu, body))
    assert np.allclose(made.rectify_left(raw[0]), expected[:, [0, 2]], atol=1e-6)
    assert np.allclose(made.rectify_right(raw[1]), expected[:, [1, 2]], atol=1e-6)
    assert np.allclose(made.raw_right(expected[:, [1, 2]]), raw[1], atol=1e-6)
