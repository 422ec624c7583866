"""The factors: that each is the Gaussian of the model, its Jacobians, and its robust kernel."""

import gtsam
import numpy as np
import pytest

from tests.smoother.drives import RIG
from vislam.core.estimator import HEIGHT_SIGMA, Problem, VerticalVelocityNoise
from vislam.core.frame import Frame, OdometryStep, StereoFrame
from vislam.estimators.smoother.factors import StereoFactors
from vislam.estimators.smoother.keys import C, H, V, W, X, landmark
from vislam.estimators.smoother.motion import OdometryMotion
from vislam.estimators.smoother.tracks import View
from vislam.geometry import se3
from vislam.models import Kernel, TrackNoise
from vislam.models.odometry import MotionNoise

DENSITY = np.array([1e-3, 2e-3, 3e-3, 0.02, 0.03, 0.04])
WALK = np.array([1e-4, 2e-4, 3e-4, 1e-3, 2e-3, 3e-3])
BIAS_SIGMA = np.array([0.01, 0.02, 0.03, 0.1, 0.2, 0.3])
BIAS_MEAN = np.array([0.001, -0.002, 0.003, 0.1, -0.2, 0.3])
FIRST_SIGMA = np.array([1e-3, 2e-3, 3e-3, 0.01, 0.02, 0.03])


def problem(**more):
    return Problem(
        rig=RIG,
        noise=MotionNoise(DENSITY, WALK),
        first_pose_sigma=FIRST_SIGMA,
        bias_mean=BIAS_MEAN,
        bias_sigma=BIAS_SIGMA,
        track_noise=TrackNoise(0.3, 0.0, 0.0),
        gate_probability=0.99,
        **more,
    )


def frame(k, *, dt, twist=None, change=None, vertical_velocity=np.nan):
    return Frame(
        k=k,
        stamp=float(k),
        dt=dt,
        stereo=StereoFrame(
            np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)), usable=np.empty(0, bool)
        ),
        odometry=OdometryStep(
            twist=np.zeros(6) if twist is None else twist,
            twist_change=np.zeros(6) if change is None else change,
            vertical_velocity=vertical_velocity,
        ),
    )


def two_frames(rng, **more):
    first = frame(0, dt=0.0, twist=rng.normal(size=6))
    return first, frame(1, dt=0.13, twist=rng.normal(size=6), change=0.1 * rng.normal(size=6), **more)


def motion_factor(rng):
    first, second = two_frames(rng)
    factor = OdometryMotion(problem()).factors(second, first)[0]
    motion, values = 0.5 * rng.normal(size=6), gtsam.Values()
    start = se3.exp(rng.normal(size=6))
    w = rng.normal(size=6)
    values.insert(X(0), gtsam.Pose3(start))
    values.insert(X(1), gtsam.Pose3(start @ se3.exp(motion)))
    values.insert(W(1), w)
    values.insert(V(1), rng.normal(size=6))
    return factor, values, motion, w, second.dt


def information(factors, values, keys):
    """Information matrix with the gradient as its last column, in the order of the keys."""
    graph = gtsam.NonlinearFactorGraph()
    for factor in factors:
        graph.add(factor)
    ordering = gtsam.Ordering()
    for key in keys:
        ordering.push_back(key)
    matrix, vector = graph.linearize(values).hessian(ordering)
    return np.column_stack([matrix, vector])


def check_jacobians(factor, values, *, rtol=1e-5):
    linear = factor.linearize(values)
    jacobian, right = linear.jacobian()
    keys, column, step = list(linear.keys()), 0, 1e-6
    for key in keys:
        size = jacobian.shape[1] - column if len(keys) == 1 else size_of(values, key)
        for axis in range(size):
            ends = []
            for sign in (1.0, -1.0):
                delta = gtsam.VectorValues()
                for other in keys:
                    by = np.zeros(size_of(values, other))
                    if other == key:
                        by[axis] = sign * step
                    delta.insert(other, by)
                ends.append(-factor.linearize(values.retract(delta)).jacobian()[1])
            slope = (ends[0] - ends[1]) / (2.0 * step)
            assert np.allclose(jacobian[:, column], slope, rtol=rtol, atol=rtol * np.abs(jacobian).max())
            column += 1
    assert column == jacobian.shape[1]
    assert np.isclose(factor.error(values), 0.5 * right @ right)


def size_of(values, key):
    zero = values.zeroVectors()
    return len(zero.at(key))


def test_motion_factor_without_its_free_end_twist_is_the_gaussian_of_the_step(rng):
    for _ in range(5):
        factor, values, motion, w, dt = motion_factor(rng)
        found = information([factor], values, [X(0), W(1), X(1), V(1)])
        by_end = np.linalg.solve(found[18:, 18:24], found[18:])
        found = found[:18] - found[:18, 18:24] @ by_end
        residual = motion - dt * w
        to_right = np.linalg.inv(se3.right_jacobian(motion))
        to_left = np.linalg.inv(se3.left_jacobian(motion))
        jacobian = np.hstack([-to_left, -dt * np.eye(6), to_right])
        weighted = jacobian.T / (dt * DENSITY**2)
        wanted = np.column_stack([weighted @ jacobian, -weighted @ residual])
        found = found[:, [*range(18), 24]]
        scale = np.sqrt(np.diagonal(wanted[:, :18]))
        assert np.allclose(
            found[:, :18] / scale / scale[:, None], wanted[:, :18] / scale / scale[:, None], atol=1e-9
        )
        assert np.allclose(found[:, 18] / scale, wanted[:, 18] / scale, rtol=1e-9, atol=1e-7)


def test_motion_factor_costs_what_the_step_is_off_once_its_end_twist_is_free(rng):
    factor, values, motion, w, dt = motion_factor(rng)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    for key in (X(0), X(1)):
        graph.add(gtsam.NonlinearEqualityPose3(key, values.atPose3(key)))
    graph.add(gtsam.PriorFactorVector(W(1), w, gtsam.noiseModel.Diagonal.Sigmas(np.full(6, 1e-9))))
    best = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    wanted = 0.5 * np.sum((motion - dt * w) ** 2 / (dt * DENSITY**2))
    assert np.isclose(factor.error(best), wanted, rtol=1e-6)


def test_jacobians_of_the_motion_factor(rng):
    factor, values, *_ = motion_factor(rng)
    check_jacobians(factor, values)


def test_jacobians_of_the_stereo_factor(rng):
    pose, key = se3.exp(0.3 * rng.normal(size=6)), landmark(0, 8.0)
    point = se3.transform(pose @ RIG.imu_T_cam, np.array([[1.0, -0.5, 8.0]]))[0]
    off, sigma = np.array([1.0, -2.0, 0.5]), np.array([0.3, 0.4, 0.2])
    z = RIG.project(np.array([1.0, -0.5, 8.0])) + off
    [factor] = StereoFactors(RIG).stereo(3, key, z=z, sigma=sigma)
    values = gtsam.Values()
    values.insert(X(3), gtsam.Pose3(pose))
    values.insert(key, point)
    check_jacobians(factor, values)
    assert np.isclose(factor.error(values), 0.5 * np.sum((off / sigma) ** 2))


def test_the_prior_of_the_bias_in_terms_of_the_first_twist(rng):
    first, second = two_frames(rng)
    prior = OdometryMotion(problem()).factors(second, first)[1]
    bias, values = rng.normal(size=6), gtsam.Values()
    values.insert(W(1), second.odometry.twist - bias)
    assert np.isclose(prior.error(values), 0.5 * np.sum(((bias - BIAS_MEAN) / BIAS_SIGMA) ** 2))
    check_jacobians(prior, values)


def test_the_walk_of_the_bias_in_terms_of_the_twists(rng):
    _, second = two_frames(rng)
    third = frame(2, dt=0.2, twist=rng.normal(size=6))
    walk = OdometryMotion(problem()).factors(third, second)[1]
    bias, later, values = rng.normal(size=6), rng.normal(size=6), gtsam.Values()
    values.insert(W(1), second.odometry.twist - bias)
    values.insert(W(2), third.odometry.twist - later)
    # The bias that acts over a step walks over the length of that step before the next has it.
    wanted = 0.5 * np.sum((later - bias) ** 2 / (second.dt * WALK**2))
    assert np.isclose(walk.error(values), wanted)
    check_jacobians(walk, values)


def test_the_clock_moves_the_twist_by_its_slope(rng):
    first, second = two_frames(rng)
    third = frame(2, dt=0.2, twist=rng.normal(size=6), change=0.1 * rng.normal(size=6))
    builder = OdometryMotion(problem(clock_sigma=0.01))
    clock, bias, later = 0.007, rng.normal(size=6), rng.normal(size=6)
    values = gtsam.Values()
    values.insert(C(0), np.array([clock]))
    values.insert(W(1), second.odometry.twist + clock * second.odometry.twist_change / second.dt - bias)
    values.insert(W(2), third.odometry.twist + clock * third.odometry.twist_change / third.dt - later)
    _, of_clock, of_bias = builder.factors(second, first)
    assert np.isclose(of_clock.error(values), 0.5 * (clock / 0.01) ** 2)
    assert np.isclose(of_bias.error(values), 0.5 * np.sum(((bias - BIAS_MEAN) / BIAS_SIGMA) ** 2))
    walk = builder.factors(third, second)[1]
    assert np.isclose(walk.error(values), 0.5 * np.sum((later - bias) ** 2 / (second.dt * WALK**2)))
    assert builder.tied(1) == [X(1), W(1), C(0)]


@pytest.mark.parametrize("known", [True, False])
def test_the_vertical_velocity_ties_the_height_to_its_rate_and_the_pose_to_the_height(rng, known):
    first, second = two_frames(rng, vertical_velocity=0.8 if known else np.nan)
    builder = OdometryMotion(problem(vertical_velocity=VerticalVelocityNoise(walk=0.03, tilt_sigma=0.05)))
    *_, between, level = builder.factors(second, first)
    values = gtsam.Values()
    values.insert(H(0), np.array([0.0, 0.0, 0.2]))
    values.insert(H(1), np.array([0.0, 0.0, 0.5]))
    pose = se3.exp(rng.normal(size=6))
    values.insert(X(1), gtsam.Pose3(pose))
    rise = second.dt * 0.8 if known else 0.0
    sigma = np.sqrt(second.dt) * 0.03 if known else second.dt * 5.0
    assert np.isclose(between.error(values), 0.5 * ((0.5 - 0.2 - rise) / sigma) ** 2)
    assert np.isclose(level.error(values), 0.5 * ((pose[2, 3] - 0.5) / HEIGHT_SIGMA) ** 2)
    check_jacobians(level, values)
    check_jacobians(between, values)


def test_with_the_vertical_velocity_the_first_pose_is_free_to_tilt_and_starts_at_height_zero(rng):
    first, _ = two_frames(rng)
    pose, height, level = OdometryMotion(
        problem(vertical_velocity=VerticalVelocityNoise(walk=0.03, tilt_sigma=0.05))
    ).factors(first, None)
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(se3.exp(np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]))))
    values.insert(H(0), np.array([0.0, 0.0, 1e-4]))
    assert np.isclose(pose.error(values), 0.5 * 0.1**2 / (0.05**2 + FIRST_SIGMA[0] ** 2))
    assert np.isclose(height.error(values), 0.5)
    assert np.isclose(level.error(values), 0.5 * (1e-4 / HEIGHT_SIGMA) ** 2)


def test_smart_factor_is_the_stereo_factors_without_their_landmark(rng):
    """With a landmark at its optimum and little noise; GTSAM triangulates linearly."""
    builder, point = StereoFactors(RIG), np.array([12.0, 1.0, 2.0])
    key, values, sigma = landmark(0, 12.0), gtsam.Values(), np.full(3, 0.4)
    values.insert(key, point)
    views, plain = [], []
    for k in range(4):
        pose = se3.exp(np.array([0.01, -0.02, 0.03, 0.9, 0.05, 0.02]) * k)
        values.insert(X(k), gtsam.Pose3(pose))
        z = RIG.project(se3.transform(RIG.cam_T_imu @ se3.inverse(pose), point[None]))[0]
        views.append(View(k, z, sigma))
        plain += builder.stereo(k, key, z=z, sigma=sigma)
    poses = [X(k) for k in range(4)]
    wanted = information(plain, values, [*poses, key])
    wanted = wanted[:24] - wanted[:24, 24:27] @ np.linalg.solve(wanted[24:, 24:27], wanted[24:])
    values.erase(key)
    found = information([builder.smart(views)], values, poses)
    assert np.allclose(found[:, :24], wanted[:, :24], rtol=1e-6, atol=1e-6 * np.abs(wanted).max())


def test_the_factor_has_the_density_and_the_weight_of_the_kernel():
    sigma, key, values = np.array([0.3, 0.4, 0.2]), landmark(0, 8.0), gtsam.Values()
    point, off = np.array([[1.0, -0.5, 8.0]]), np.array([3.0, -2.0, 1.0])
    values.insert(X(0), gtsam.Pose3())
    values.insert(key, se3.transform(RIG.imu_T_cam, point)[0])
    z = RIG.project(point[0]) + off
    kernel = Kernel(4.0)
    [robust] = StereoFactors(RIG, kernel=kernel).stereo(0, key, z=z, sigma=sigma)
    squared = float(np.sum((off / sigma) ** 2))
    # -log p of Student's density in three dimensions, less its value at zero.
    assert np.isclose(robust.error(values), 3.5 * np.log(1.0 + squared / 4.0), rtol=1e-12)
    [plain] = StereoFactors(RIG).stereo(0, key, z=z, sigma=sigma)
    weighted, whole = (information([factor], values, [X(0), key]) for factor in (robust, plain))
    assert np.allclose(weighted, kernel.weight(np.array(squared)) * whole, rtol=1e-9)
