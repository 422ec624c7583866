"""Raw inertia as the smoother's model of motion: its factor, its prior, and agreement with the filter."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest
from scipy.stats import chi2

from tests.inertial import IMU, drive, errors, ran
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.core.imu import ImuSeries
from vislam.estimators.ekf import motion as filters
from vislam.estimators.smoother.inertial import InertialMotion
from vislam.estimators.smoother.keys import B, V, X
from vislam.evaluation.normalised import pose_errors
from vislam.geometry import se3
from vislam.models.imu import STATES

GTSAM_ORDER = np.r_[0:9, 12:15, 9:12]


def predicted(config, dataset, frames):
    """Covariance and mean at the last of some frames without a camera, by factors and by the filter."""
    problem = make_problem(config, dataset)
    smoother, motion = InertialMotion(problem), filters.make(problem)
    start = filters.navigation(problem, motion)
    pose, nav, cov, there = start.world_T_imu, start.nav, start.cov, np.eye(4)
    graph, values, before = gtsam.NonlinearFactorGraph(), gtsam.Values(), None
    order = gtsam.Ordering()
    for frame in dataset.sequence.first(frames).frames(pixel_sigma(config, dataset)):
        for factor in smoother.factors(frame, before):
            graph.add(factor)
        there = smoother.predict(frame, there)
        smoother.insert(values, frame, there)
        for key in smoother.keys(frame.k):
            order.push_back(key)
        if before is not None:
            step = motion.propagate(start.layout, pose, nav, frame)
            pose, nav = pose @ step.prev_T_next, nav + step.change
            cov = step.transition @ cov @ step.transition.T + step.noise
        before = frame
    jacobian, _ = graph.linearize(values).jacobian(order)
    theirs = np.linalg.inv(jacobian.T @ jacobian)[-15:, -15:]
    k = frames - 1
    means = values.atPose3(X(k)).matrix(), values.atVector(V(k)), values.atConstantBias(B(k)).vector()
    assert np.allclose(means[0], pose, atol=1e-12)
    assert np.allclose(means[1], nav[start.layout["velocity"]], atol=1e-12)
    ours = cov[np.ix_(GTSAM_ORDER, GTSAM_ORDER)]
    scale = np.sqrt(np.diagonal(ours))
    return np.abs((ours - theirs) / np.outer(scale, scale)).max()


def test_the_step_and_its_covariance_are_those_of_the_filter():
    config, dataset = drive()
    assert predicted(config, dataset, 5) < 1e-6


def test_a_step_that_samples_do_not_cover_is_that_of_the_filter():
    config, dataset = drive()
    whole = dataset.sequence.imu
    kept = (whole.stamp < 0.21) | (whole.stamp > 0.29)
    torn = ImuSeries(whole.stamp[kept], whole.gyro[kept], whole.accel[kept])
    assert predicted(config, replace(dataset, sequence=replace(dataset.sequence, imu=torn)), 4) < 1e-6


def test_a_prior_with_correlations_is_that_of_the_filter():
    """As an initialisation from data has it."""
    config, dataset = drive()
    prior = dataset.sequence.start
    scale = np.sqrt(np.diagonal(prior.cov))
    root = np.eye(15) + 0.2 * np.random.default_rng(5).normal(size=(15, 15))
    mixed = replace(prior, cov=np.outer(scale, scale) * (root @ root.T))
    sequence = replace(dataset.sequence, start=mixed)
    assert predicted(config, replace(dataset, sequence=sequence), 4) < 1e-6


SMALL = replace(
    IMU,
    gyro_density=1e-5,
    accel_density=1e-4,
    gyro_walk=1e-5,
    accel_walk=1e-4,
    tilt_sigma=2e-5,
    velocity_sigma=2e-4,
    gyro_bias_sigma=2e-5,
    accel_bias_sigma=2e-4,
    gauge_sigma=1e-6,
)


def test_filter_and_smoother_agree_where_all_is_linear():
    config, dataset = drive(
        seed=6, frames=6, path="loop", depth_min=3.0, depth_max=6.0, speed=2.0, pixel=0.1, imu=SMALL
    )
    _, eks = ran("eks", config, dataset, gate=False)
    _, batch = ran("batch", config, dataset)
    apart = np.abs(se3.local(eks.final.world_T_imu, batch.final.world_T_imu))
    assert apart.max() < 1e-6
    for name in STATES:
        off = eks.states[name].value[-1] - batch.states[name].value[-1]
        assert np.all(np.abs(off) < 0.02 * eks.states[name].sigma[-1])


@pytest.mark.parametrize("name", ["isam2", "batch", "fixed_lag"])
def test_a_drive_is_found_and_its_states_reported(name):
    config, dataset = drive()
    _, run = ran(name, config, dataset, pose_cov_every=8)
    assert run.complete, run.log.error
    position, turn = errors(run, dataset)
    assert position[-1] < 1.0
    assert turn.max() < 0.04
    assert set(run.states) == set(STATES)
    assert np.all(run.states["gyro_bias"].sigma[24] < 0.2 * IMU.gyro_bias_sigma)
    assert np.isnan(run.states["velocity"].sigma[23]).all()


def test_filters_and_smoothers_say_the_same_of_their_information():
    config, dataset = drive()
    runs = [
        ran(name, config, replace(dataset, sequence=dataset.sequence.first(4)))[1]
        for name in ("ekf", "isam2", "msckf")
    ]
    assert runs[0].information == runs[1].information == runs[2].information


def test_steps_of_the_twist_are_refused():
    config, dataset = drive()
    with pytest.raises(ConfigError, match="motion: between is a step of the recorded twist"):
        ran("isam2_between", config, dataset)


@pytest.mark.statistical
def test_what_keeps_four_directions_free_is_as_right_as_it_says():
    """NEES of the last pose over ten drives; false alarm 1e-3 each, and the standard filter is refuted."""
    drives, members = 10, {"ekf": {"gate": False}, "ekf_invariant": {"gate": False}, "eks": {"gate": False}}
    members |= {name: {"marginals": "poses"} for name in ("isam2", "batch")}
    total = dict.fromkeys(members, 0.0)
    for seed in range(drives):
        config, dataset = drive(seed=100 + seed, frames=40, pixel=0.5)
        for name, options in members.items():
            _, run = ran(name, config, dataset, **options)
            total[name] += float(pose_errors(run, dataset.reference)["pose"].nees[-1])
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 6 * drives)
    assert total.pop("ekf") > 2.0 * high
    assert all(low < one < high for one in total.values()), total
