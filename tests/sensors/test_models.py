"""Measurement and motion models against GTSAM and finite differences."""

import gtsam
import numpy as np
import pytest

from vislam.geometry import se3
from vislam.models import StereoRig, TrackNoise, independent_sigma
from vislam.models.odometry import MotionNoise, integrate, transition

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


@pytest.mark.parametrize("parts", [2, 5])
def test_the_noise_of_a_step_is_that_of_its_parts(parts: int):
    """White noise and random walks: variances add up over time, however it is cut."""
    twist, bias, dt = np.array([0.01, -0.02, 0.1, 0.5, 0.1, -0.2]), np.zeros(6), 0.5
    whole = integrate(twist, bias=bias, dt=dt, noise=NOISE)
    part = integrate(twist, bias=bias, dt=dt / parts, noise=NOISE)
    assert np.allclose(parts * part.bias_cov, whole.bias_cov, rtol=1e-12, atol=0.0)
    assert np.allclose(whole.bias_cov, dt * np.diag(NOISE.bias_walk**2), rtol=1e-12, atol=0.0)
    cov = np.zeros((6, 6))
    for _ in range(parts):
        move = se3.adjoint(se3.inverse(part.prev_T_next))
        cov = move @ cov @ move.T + part.cov
    assert np.allclose(cov, whole.cov, rtol=0.1, atol=0.02 * np.abs(whole.cov).max())
