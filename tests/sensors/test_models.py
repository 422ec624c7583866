"""Measurement and motion models against GTSAM and finite differences."""

import gtsam
import numpy as np
import pytest

from vislam.ekf import measurement
from vislam.geometry import se3
from vislam.motion import MotionNoise, integrate, transition
from vislam.sensors import StereoRig, TrackNoise, independent_sigma

RIG = StereoRig(500.0, 480.0, 320.0, 200.0, 0.5, se3.exp(np.array([0.1, -0.2, 0.3, 0.4, 0.5, 0.6])))
NOISE = MotionNoise(np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]), np.full(6, 0.01))


@pytest.fixture
def points_cam(rng):
    return np.column_stack([rng.uniform(-5, 5, (6, 2)), rng.uniform(4, 30, 6)])


def test_projection_is_gtsams_and_back_projection_inverts_it(points_cam):
    camera = gtsam.StereoCamera(gtsam.Pose3(), gtsam.Cal3_S2Stereo(500.0, 480.0, 0.0, 320.0, 200.0, 0.5))
    z = RIG.project(points_cam)
    assert np.allclose(z, [camera.project(point).vector() for point in points_cam])
    assert np.allclose(RIG.back_project(z), points_cam)


def test_jacobians_of_the_rig(points_cam):
    z = RIG.project(points_cam)
    forward, backward = RIG.projection_jacobian(points_cam), RIG.back_projection_jacobian(z)
    assert np.allclose(forward @ backward, np.eye(3), atol=1e-12)
    for axis, unit in enumerate(1e-6 * np.eye(3)):
        slope = (RIG.project(points_cam + unit) - RIG.project(points_cam - unit)) / 2e-6
        assert np.allclose(forward[:, :, axis], slope, atol=1e-5)


def test_stereo_jacobians_by_pose_and_landmark(rng, points_cam):
    pose = se3.exp(rng.normal(size=6))
    match = rng.normal(0.0, 0.1, len(points_cam))
    landmarks = np.column_stack([se3.transform(pose @ RIG.imu_T_cam, points_cam), match])
    found = measurement.predict(RIG, pose, landmarks)
    expected = RIG.project(points_cam)
    disparity = expected[:, 0] - expected[:, 1]
    assert np.allclose(found.z[:, [0, 2]], expected[:, [0, 2]])
    assert np.allclose(found.z[:, 0] - found.z[:, 1], (1.0 + match) * disparity)
    for axis, xi in enumerate(1e-6 * np.eye(6)):
        there = measurement.predict(RIG, se3.retract(pose, xi), landmarks).z
        back = measurement.predict(RIG, se3.retract(pose, -xi), landmarks).z
        assert np.allclose(found.by_pose[:, :, axis], (there - back) / 2e-6, atol=1e-4)
    for axis, unit in enumerate(1e-6 * np.eye(4)):
        there = measurement.predict(RIG, pose, landmarks + unit).z
        back = measurement.predict(RIG, pose, landmarks - unit).z
        assert np.allclose(found.by_landmark[:, :, axis], (there - back) / 2e-6, atol=1e-4)


def test_landmark_initialisation_jacobians(rng, points_cam):
    pose, z = se3.exp(rng.normal(size=6)), RIG.project(points_cam)
    _, by_pose, by_measurement = measurement.initialise(RIG, pose, z)
    for axis, xi in enumerate(1e-6 * np.eye(6)):
        slope = (
            measurement.initialise(RIG, se3.retract(pose, xi), z)[0]
            - measurement.initialise(RIG, se3.retract(pose, -xi), z)[0]
        ) / 2e-6
        assert np.allclose(by_pose[:, :, axis], slope, atol=1e-6)
    for axis, unit in enumerate(1e-5 * np.eye(3)):
        there, back = (measurement.initialise(RIG, pose, z + sign * unit)[0] for sign in (1, -1))
        assert np.allclose(by_measurement[:, :, axis], (there - back) / 2e-5, rtol=1e-5, atol=1e-7)


def test_a_landmark_starts_with_the_point_that_a_match_error_would_mean(rng, points_cam):
    pose, share = se3.exp(rng.normal(size=6)), 1e-6
    z = RIG.project(points_cam)
    _, _, by_measurement = measurement.initialise(RIG, pose, z)
    mended = z.copy()
    mended[:, 1] += share * (z[:, 0] - z[:, 1])
    slope = (measurement.initialise(RIG, pose, mended)[0] - measurement.initialise(RIG, pose, z)[0]) / share
    assert np.allclose(by_measurement[:, :3, 3], slope[:, :3], rtol=1e-4)
    assert np.all(by_measurement[:, 3] == [0, 0, 0, 1])


def test_a_point_drifts_by_the_pixels_it_is_told_to(rng, points_cam):
    pose = se3.exp(rng.normal(size=6))
    points = se3.transform(pose @ RIG.imu_T_cam, points_cam)
    cov = measurement.drift_cov(RIG, pose, points, drift=0.3)
    landmarks = np.column_stack([points, np.zeros(len(points))])
    by_point = measurement.predict(RIG, pose, landmarks).by_landmark[:, :, :3]
    pixels = by_point @ cov @ by_point.transpose(0, 2, 1)
    expected = 0.09 * np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]])
    assert np.allclose(pixels, expected, atol=1e-9)


def test_independent_noise_has_the_variance_of_the_three_errors():
    noise = TrackNoise(0.3, 0.2, 0.8)
    age, disparity = np.array([0, 4]), np.array([10.0, 20.0])
    sigma = independent_sigma(noise, age=age, disparity=disparity, first_disparity=np.full(2, 10.0))
    variance = 0.09 + np.mean(0.04 * age + 0.5 * (0.8 * disparity / 10.0) ** 2)
    assert np.allclose(sigma**2, variance * np.array([1.0, 1.0, 0.5]))


def test_transition_is_the_derivative_of_the_motion(rng):
    twist, bias, pose = rng.normal(size=6), 0.1 * rng.normal(size=6), se3.exp(rng.normal(size=6))
    step = integrate(twist, bias=bias, dt=0.2, noise=NOISE)
    matrix, noise = transition(step)
    after = pose @ step.prev_T_next
    for axis, error in enumerate(1e-6 * np.eye(12)):

        def moved(sign, error=error):
            other = integrate(twist, bias=bias + sign * error[6:], dt=0.2, noise=NOISE)
            return se3.local(after, se3.retract(pose, sign * error[:6]) @ other.prev_T_next)

        assert np.allclose(matrix[:6, axis], (moved(1) - moved(-1)) / 2e-6, atol=1e-8)
    assert np.all(np.linalg.eigvalsh(noise) > 0)
    assert np.allclose(matrix[6:, 6:], np.eye(6))
