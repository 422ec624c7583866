"""The measurement of the joint state, in both charts: against projection and finite differences."""

import numpy as np
import pytest

from vislam.estimators.ekf import parametrisation
from vislam.estimators.ekf.layout import NavLayout
from vislam.estimators.ekf.measurement import Camera
from vislam.estimators.ekf.motion import up_axis
from vislam.geometry import se3, so3
from vislam.models import StereoRig

RIG = StereoRig(500.0, 480.0, 320.0, 200.0, 0.5, se3.exp(np.array([0.1, -0.2, 0.3, 0.4, 0.5, 0.6])))
N = 6
both = pytest.mark.parametrize("kind", ["point", "anchored_uvd"])
BLOCKS = {"camera_rotation": 3, "disparity_offset": 1, "principal_point": 2, "focal_scale": 1}
LAYOUT = NavLayout({"twist_bias": 6, **BLOCKS})
OFFSET = LAYOUT["disparity_offset"].start
SHARED = LAYOUT["camera_rotation"].start


class Scene:
    """Landmarks seen first from one pose and now from another."""

    def __init__(self, kind: parametrisation.ParametrisationName, rng: np.random.Generator) -> None:
        self.camera = Camera(RIG, parametrisation.make(kind, RIG), LAYOUT)
        self.pose = se3.exp(rng.normal(size=6))
        self.nav = np.zeros(LAYOUT.size)
        self.nav[SHARED:] = rng.normal(0.0, [0.05, 0.05, 0.05, 0.7, 8.0, 8.0, 0.03])
        self.errors = self.camera.errors(self.nav)
        self.rig = self.errors.rig(RIG)
        points_cam = np.column_stack([rng.uniform(-5, 5, (N, 2)), rng.uniform(6, 30, N)])
        self.points = se3.transform(self.pose @ self.rig.imu_T_cam, points_cam)
        first_z = self.project(points_cam)
        self.first_z = first_z
        self.anchors, self.landmarks, self.by_nav, self.by_z = self.camera.initialise(
            self.pose, self.nav, first_z
        )
        self.now = se3.retract(self.pose, np.array([0.02, -0.03, 0.05, 0.8, -0.1, 0.05]))

    def project(self, points_cam):
        return self.rig.project(points_cam) + self.errors.offset

    def predict(self, pose=None, landmarks=None, nav=None):
        return self.view(pose, landmarks, nav).measurement()

    def view(self, pose=None, landmarks=None, nav=None):
        return self.camera.view(
            self.now if pose is None else pose,
            self.nav if nav is None else nav,
            self.anchors,
            self.landmarks if landmarks is None else landmarks,
        )


@pytest.fixture
def scene(kind, rng):
    return Scene(kind, rng)


def slope(function, step=1e-6):
    return (function(step) - function(-step)) / (2.0 * step)


@both
def test_a_landmark_is_seen_where_its_point_projects(scene):
    in_camera = se3.transform(se3.inverse(scene.now @ scene.rig.imu_T_cam), scene.points)
    assert np.allclose(scene.predict(), scene.project(in_camera))
    assert np.allclose(scene.view().depth, in_camera[:, 2])
    points, _ = scene.camera.parametrisation.points(scene.landmarks[:, :3])
    assert np.allclose(
        np.einsum("nij,nj->ni", scene.anchors, np.column_stack([points, np.ones(N)]))[:, :3], scene.points
    )


@both
def test_match_error_and_offset_add_to_the_disparity(scene, rng):
    plain, landmarks = scene.predict(), scene.landmarks.copy()
    landmarks[:, 3] = rng.normal(0.0, 0.1, N)
    z = scene.predict(landmarks=landmarks)
    offset = scene.nav[OFFSET]
    expected = (1.0 + landmarks[:, 3]) * (plain[:, 0] - plain[:, 1] - offset) + offset
    assert np.allclose(z[:, 0] - z[:, 1], expected)
    assert np.allclose(z[:, [0, 2]], plain[:, [0, 2]])


@both
def test_jacobians_by_navigation_state_and_landmark(scene, rng):
    scene.landmarks[:, 3] = rng.normal(0.0, 0.1, N)
    by_nav, by_landmark = scene.view().jacobians()
    for axis, unit in enumerate(np.eye(6)):
        found = slope(lambda h, unit=unit: scene.predict(pose=se3.retract(scene.now, h * unit)))
        assert np.allclose(by_nav[:, :, axis], found, atol=1e-4)
    for axis in range(SHARED, LAYOUT.size):
        unit = np.eye(LAYOUT.size)[axis]
        found = slope(lambda h, unit=unit: scene.predict(nav=scene.nav + h * unit))
        assert np.allclose(by_nav[:, :, axis], found, rtol=1e-6, atol=1e-4)
    assert not by_nav[:, :, LAYOUT["twist_bias"]].any()
    for axis, unit in enumerate(np.eye(4)):
        found = slope(lambda h, u=unit: scene.predict(landmarks=scene.landmarks + h * u))
        assert np.allclose(by_landmark[:, :, axis], found, atol=1e-4)


@both
def test_initialisation_jacobians(scene):
    """With the anchor held: what a first observation means in its coordinates."""

    def coordinates(pose, z, nav=scene.nav):
        anchors, landmarks, _, _ = scene.camera.initialise(pose, nav, z)
        homogeneous = scene.camera.parametrisation.homogeneous(landmarks[:, :3])
        moved = np.linalg.inv(scene.anchors) @ anchors @ homogeneous[:, :, None]
        return scene.camera.parametrisation.coordinates(moved[:, :, 0])

    for axis, unit in enumerate(np.eye(6)):
        found = slope(
            lambda h, unit=unit: coordinates(se3.retract(scene.pose, h * unit), scene.first_z), 1e-5
        )
        assert np.allclose(scene.by_nav[:, :3, axis], found, rtol=1e-4, atol=1e-5)
    for axis in range(SHARED, LAYOUT.size):
        unit = np.eye(LAYOUT.size)[axis]
        found = slope(lambda h, unit=unit: coordinates(scene.pose, scene.first_z, scene.nav + h * unit), 1e-5)
        assert np.allclose(scene.by_nav[:, :3, axis], found, rtol=1e-4, atol=1e-5)
    for axis, unit in enumerate(np.eye(3)):
        found = slope(lambda h, unit=unit: coordinates(scene.pose, scene.first_z + h * unit), 1e-4)
        assert np.allclose(scene.by_z[:, :3, axis], found, rtol=1e-4, atol=1e-6)


@both
def test_a_landmark_starts_with_the_point_that_a_match_error_would_mean(scene):
    share = 1e-6
    mended = scene.first_z.copy()
    mended[:, 1] += share * (mended[:, 0] - mended[:, 1] - scene.nav[OFFSET])
    other = scene.camera.initialise(scene.pose, scene.nav, mended)[1]
    assert np.allclose(scene.by_z[:, :3, 3], (other - scene.landmarks)[:, :3] / share, rtol=1e-4, atol=1e-4)
    assert np.all(scene.by_z[:, 3] == [0, 0, 0, 1])


@both
def test_a_point_drifts_by_the_pixels_it_is_told_to(scene):
    cov = scene.view().drift_cov(0.3)
    by_q = scene.view().jacobians()[1][:, :, :3]
    pixels = by_q @ cov @ by_q.transpose(0, 2, 1)
    assert np.allclose(pixels, 0.09 * np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]]), atol=1e-9)


@both
def test_a_motion_told_in_the_body_moves_the_coordinates(scene, rng):
    parametrisation, body_T_anchor = scene.camera.parametrisation, se3.exp(rng.normal(size=(N, 6)))
    found = parametrisation.moved(scene.landmarks[:, :3], body_T_anchor)
    homogeneous = parametrisation.homogeneous(scene.landmarks[:, :3])

    def coordinates(xi):
        in_anchor = se3.inverse(body_T_anchor) @ se3.exp(xi) @ body_T_anchor
        return parametrisation.coordinates((in_anchor @ homogeneous[:, :, None])[:, :, 0])

    for axis, unit in enumerate(np.eye(6)):
        expected = slope(lambda h, unit=unit: coordinates(h * unit), 1e-5)
        assert np.allclose(found[:, :, axis], expected, rtol=1e-5, atol=1e-6)


@both
def test_what_pose_and_landmarks_share_cannot_be_seen(scene):
    """A motion of the whole world changes no measurement: the directions nothing must be learnt about.

    Whatever the shared errors are: they have no part in it.
    """
    by_nav, by_landmark = scene.view().jacobians()
    of_pose = se3.adjoint(se3.inverse(scene.now))
    of_landmarks = scene.camera.parametrisation.moved(scene.landmarks[:, :3], scene.anchors)
    seen = by_nav[:, :, :6] @ of_pose + by_landmark[:, :, :3] @ of_landmarks
    assert np.abs(seen).max() < 1e-9 * np.abs(by_nav).max()


def test_a_point_at_infinity_and_beyond_is_no_exception(rng):
    scene = Scene("anchored_uvd", rng)
    scene.landmarks[:2, 2] = [0.0, -0.1]
    z = scene.predict()
    by_nav, by_landmark = scene.view().jacobians()
    assert np.isfinite(z).all()
    assert np.isfinite(by_nav).all()
    assert np.isfinite(by_landmark).all()
    # At infinity a shift of the camera is not seen, a turn is.
    assert np.abs(by_nav[0, :, 3:6]).max() == 0.0
    assert np.abs(by_nav[0, :, :3]).max() > 100.0


def test_the_vertical_and_its_derivative(rng):
    tilt = rng.normal(0.0, 0.2, 2)
    up, by_tilt = up_axis(tilt)
    assert np.allclose(up, so3.exp(np.array([*tilt, 0.0])) @ [0.0, 0.0, 1.0])
    for axis, unit in enumerate(np.eye(2)):
        assert np.allclose(
            by_tilt[:, axis], slope(lambda h, unit=unit: up_axis(tilt + h * unit)[0]), atol=1e-8
        )
