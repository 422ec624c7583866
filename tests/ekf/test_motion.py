"""Models of motion of the filter: the step against finite differences, GTSAM's prior, and the smoother."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from gtsam.symbol_shorthand import B, X

from tests.smoother.drives import RIG, drive, filtered, gap, member
from vislam.core.estimator import Problem, VerticalVelocityNoise
from vislam.core.frame import Frame, OdometryStep, StereoFrame
from vislam.estimators.ekf.layout import NavLayout
from vislam.estimators.ekf.motion import OdometryMotion, SmoothMotion
from vislam.geometry import se3
from vislam.models import TrackNoise
from vislam.models.odometry import POSE, MotionNoise

ACCELERATION = np.array([0.03, 0.02, 0.1, 1.0, 0.2, 0.3])
MOTIONS = [OdometryMotion, SmoothMotion]


def built(kind):
    problem = Problem(
        rig=RIG,
        noise=MotionNoise(np.full(6, 0.01), np.full(6, 0.001), ACCELERATION),
        first_pose_sigma=np.full(6, 1e-3),
        bias_mean=np.zeros(6),
        bias_sigma=np.full(6, 0.1),
        track_noise=TrackNoise(0.3, 0.0, 0.0),
        gate_probability=0.99,
        clock_sigma=0.01,
        vertical_velocity=VerticalVelocityNoise(walk=0.1, tilt_sigma=0.05),
    )
    motion = kind(problem)
    return motion, NavLayout({name: len(block.mean) for name, block in motion.blocks().items()})


@pytest.fixture
def frame(rng):
    twist = np.array([0.02, -0.03, 0.4, 9.0, 0.3, -0.2])
    nothing = np.empty(0, np.int64), np.empty((0, 3)), np.empty((0, 3)), np.empty(0, bool)
    odometry = OdometryStep(twist, 0.1 * rng.normal(size=6), 0.4)
    return Frame(k=3, stamp=0.3, dt=0.12, stereo=StereoFrame(*nothing), odometry=odometry)


def state(layout, frame, rng):
    nav = 0.01 * rng.normal(size=layout.size)
    if "twist" in layout:
        nav[layout["twist"]] = frame.odometry.twist + 0.05 * rng.normal(size=6)
    return se3.exp(rng.normal(size=6)), nav


@pytest.mark.parametrize("kind", MOTIONS)
def test_transition_is_the_derivative_of_the_step(kind, rng, frame):
    motion, layout = built(kind)
    pose, nav = state(layout, frame, rng)
    found = motion.propagate(layout, pose, nav, frame)
    after, means = pose @ found.prev_T_next, nav + found.change
    for axis in range(layout.size):
        slopes = []
        for sign in (1.0, -1.0):
            error = np.zeros(layout.size)
            error[axis] = 1e-6 * sign
            other = motion.propagate(layout, pose, nav + error, frame)
            moved = nav + error + other.change - means
            moved[POSE] = se3.local(after, se3.retract(pose, error[POSE]) @ other.prev_T_next)
            slopes.append(moved)
        assert np.allclose(found.transition[:, axis], (slopes[0] - slopes[1]) / 2e-6, atol=1e-7)


@pytest.mark.parametrize("kind", MOTIONS)
def test_jacobians_of_what_is_measured(kind, rng, frame):
    motion, layout = built(kind)
    pose, nav = state(layout, frame, rng)
    for index, found in enumerate(motion.measurements(layout, pose, nav, frame)):
        for axis in range(layout.size):
            ends = []
            for sign in (1.0, -1.0):
                error = np.zeros(layout.size)
                error[axis] = 1e-6 * sign
                there = motion.measurements(layout, se3.retract(pose, error[POSE]), nav + error, frame)
                ends.append(-there[index].innovation)
            assert np.allclose(found.by_nav[:, axis], (ends[0] - ends[1]) / 2e-6, atol=1e-6)


def test_covariance_of_a_smooth_step_is_that_of_gtsams_prior(rng, frame):
    motion, layout = built(SmoothMotion)
    pose, nav = state(layout, frame, rng)
    own = np.r_[POSE, layout["twist"]]
    sigma = np.concatenate([np.full(3, 0.01), np.full(3, 0.1), 0.3 * ACCELERATION])
    found = motion.propagate(layout, pose, nav, frame)
    start = np.zeros((layout.size, layout.size))
    start[own, own] = sigma**2
    ours = (found.transition @ start @ found.transition.T + found.noise)[np.ix_(own, own)]

    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    diagonal = gtsam.noiseModel.Diagonal.Sigmas
    graph.add(gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), diagonal(sigma[:6])))
    graph.add(gtsam.PriorFactorVector(B(0), nav[layout["twist"]], diagonal(sigma[6:])))
    ends = gtsam.StateData(X(0), B(0), 0.0), gtsam.StateData(X(1), B(1), frame.dt)
    graph.add(gtsam.WnoaMotionFactorPose3(*ends, ACCELERATION**2))
    values.insert(X(0), gtsam.Pose3())
    values.insert(X(1), gtsam.Pose3(found.prev_T_next))
    for k in range(2):
        values.insert(B(k), nav[layout["twist"]])
    keys = gtsam.KeyVector([X(1), B(1)])
    theirs = gtsam.Marginals(graph, values).jointMarginalCovariance(keys).fullMatrix()
    scale = np.sqrt(np.diagonal(theirs))
    assert np.abs((ours - theirs) / np.outer(scale, scale)).max() < 2e-3


def smooth(config, density):
    return replace(config, noise=replace(config.noise, acceleration_density=density))


@pytest.mark.parametrize("run", ["filter", "smoother"])
def test_a_body_that_may_do_anything_is_bridged_by_the_inertial_samples_alone(run):
    config, dataset = drive(seed=2, frames=25, tracks_in_view=20)
    anything = smooth(config, (100.0,) * 6)
    go = filtered if run == "filter" else lambda config, dataset: member("batch", config, dataset)
    plain, free = go(config, dataset), go(anything, dataset)
    tight = go(smooth(config, (0.002, 0.002, 0.002, 0.02, 0.02, 0.02)), dataset)
    assert max(gap(plain.final.world_T_imu, free.final.world_T_imu)) < 1e-3
    assert gap(plain.final.world_T_imu, tight.final.world_T_imu)[1] > 1e-2


def test_smooth_motion_means_the_same_to_filter_and_smoother():
    """All is nearly linear, the turns of a loop included, so that both find the same last pose."""
    config, dataset = drive(
        seed=6,
        frames=25,
        path="loop",
        tracks_in_view=25,
        depth_max=20.0,
        pixel=0.02,
        gyro=2e-4,
        velocity=2e-3,
    )
    config = smooth(config, (0.003, 0.003, 0.01, 0.03, 0.03, 0.03))
    config = replace(config, noise=replace(config.noise, first_pose_sigma=(1e-6,) * 6))
    ekf, plain = filtered(config, dataset), filtered(smooth(config, None), dataset)
    isam2 = member("batch", config, dataset)
    sigma = np.sqrt(np.diagonal(ekf.final.cov[-1]))
    off = np.abs(se3.local(ekf.final.world_T_imu[-1], isam2.final.world_T_imu[-1]))
    assert np.all(off < 0.1 * sigma)
    assert np.abs(se3.local(ekf.final.world_T_imu[-1], plain.final.world_T_imu[-1]) / sigma).max() > 0.3
