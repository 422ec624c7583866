"""Odometry from frame to frame: exact where it can be, robust, and honest about a step."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import recorded
from tests.smoother.drives import dark, drive, exact, gap, negative_disparities
from vislam.comparison import config as configuration
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.open import open_dataset
from vislam.estimators import loop
from vislam.evaluation.trajectory import path_length
from vislam.evaluation.trajectory_scores import score_trajectory
from vislam.geometry import se3
from vislam.models import CAMERA_AXES, StereoRig, TrackNoise
from vislam.models import odometry as motion
from vislam_baselines import stereo_vo
from vislam_baselines.observations import look
from vislam_baselines.stereo_step import Prior, fit_step, residual_cov

CONFIGS = Path(__file__).parents[2] / "configs"
MOUNTING = se3.from_rotation_translation(CAMERA_AXES, np.array([1.0, 0.1, 0.5]))
RIG = StereoRig(500.0, 510.0, 320.0, 200.0, 0.5, MOUNTING)
NOISE = TrackNoise(0.2, 0.3, 0.5)
MOTION = se3.exp(np.array([0.01, -0.02, 0.03, 1.0, 0.1, -0.05]))


def odometry(config, dataset, *, usable=None, **options):
    built = stereo_vo.build(make_problem(config, dataset), options)
    sigma = pixel_sigma(config, dataset)
    return loop.run(built, dataset.sequence, sigma, name="stereo_vo", usable=usable)


def with_wrong_twist(dataset, error=0.05):
    sequence = dataset.sequence
    return replace(dataset, sequence=replace(sequence, twist=sequence.twist + error))


def points_before(rng, n):
    """Points in the camera before."""
    return np.column_stack([rng.uniform(-8, 8, n), rng.uniform(-2, 2, n), rng.uniform(6, 40, n)])


def after(points):
    """Where they are seen once the body has moved."""
    return look(RIG, MOTION, se3.transform(RIG.imu_T_cam, points)).z


def noisy_pairs(points, rng):
    """Both measurements of points, with all three errors of a track."""
    n = len(points)
    match = rng.normal(size=n) * NOISE.match_sigma(RIG.fx * RIG.baseline / points[:, 2])
    sighted = []
    for exactly in (RIG.project(points), after(points)):
        z = exactly + NOISE.sigma * rng.normal(size=(n, 3))
        z[:, 1] -= match * (exactly[:, 0] - exactly[:, 1])
        sighted.append(z)
    column, row = NOISE.drift * rng.normal(size=(2, n))
    return sighted[0], sighted[1] + np.column_stack([column, column, row])


def fit(before, later, *, noise=NOISE, start=MOTION, prior=None):
    found = fit_step(RIG, noise, before, later, start=start, prior=prior)
    assert found is not None
    return found


def test_without_noise_the_path_is_exact_whatever_the_twist_says():
    config, dataset = exact(seed=4)
    truth = dataset.reference.pose
    run = odometry(config, with_wrong_twist(dataset))
    assert run.complete
    angle, distance = gap(run.final.world_T_imu, se3.inverse(truth[0]) @ truth)
    assert angle < 1e-9
    assert distance < 1e-7
    assert run.log.counts["inertial_steps"] == 0


def test_residuals_scatter_as_they_are_said_to(rng):
    for point in points_before(rng, 4):
        points = np.tile(point, (20000, 1))
        before, later = noisy_pairs(points, rng)
        estimated = RIG.back_project(before)
        seen = look(RIG, MOTION, se3.transform(RIG.imu_T_cam, estimated))
        z, seen_truly = RIG.project(points[:1]), look(RIG, MOTION, se3.transform(RIG.imu_T_cam, points[:1]))
        said = residual_cov(RIG, NOISE, z, points[:1], seen_truly)[0]
        root = np.linalg.inv(np.linalg.cholesky(said))
        scatter = root @ np.cov((later - seen.z).T) @ root.T
        # First order in errors of some per cent of the depth.
        assert scatter == pytest.approx(np.eye(3), abs=0.1)


@pytest.mark.statistical
def test_a_step_is_as_uncertain_as_it_says(rng):
    nees = []
    for _ in range(300):
        found = fit(*noisy_pairs(points_before(rng, 40), rng))
        error = se3.local(found.prev_T_next, MOTION)
        nees.append(error @ np.linalg.solve(found.cov, error))
    # The mean of chi-square of 6 over 300 draws is 6 +- 0.2. The weights do not count on Gaussian noise, and
    # the depths are off by some per cent.
    assert 5.0 < np.mean(nees) < 7.5


@pytest.mark.statistical
def test_the_weighted_sum_of_squares_is_that_of_its_distribution(rng):
    share = []
    for _ in range(100):
        points = points_before(rng, 60)
        before, later = RIG.project(points), after(points)
        seen = look(RIG, MOTION, se3.transform(RIG.imu_T_cam, points))
        root = np.linalg.cholesky(residual_cov(RIG, NOISE, before, points, seen))
        stretch = np.sqrt(2.0 / rng.chisquare(2.0, 60))[:, None]
        later = later + stretch * (root @ rng.normal(size=(60, 3, 1)))[:, :, 0]
        found = fit(before, later)
        assert found.dof == 174
        share.append(found.chi_square / found.dof)
    assert np.mean(share) == pytest.approx(1.0, abs=0.03)


def test_outliers_lose_their_weight(rng):
    before, later = noisy_pairs(points_before(rng, 60), rng)
    clean = fit(before, later)
    wrong = np.arange(60) % 4 == 0
    later[wrong] += rng.choice([-1.0, 1.0], (15, 3)) * rng.uniform(10.0, 40.0, (15, 3))
    found = fit(before, later, start=se3.retract(MOTION, np.array([0.01, 0.01, -0.01, 0.2, 0.1, 0.1])))
    assert found.weight[wrong].max() < 0.1 * np.median(found.weight[~wrong])
    apart = se3.local(clean.prev_T_next, found.prev_T_next)
    assert apart @ np.linalg.solve(clean.cov, apart) < 6.0


def test_too_few_tracks_before_the_camera_are_no_step(rng):
    points = points_before(rng, 5)
    assert fit_step(RIG, NOISE, RIG.project(points), after(points), start=MOTION) is None
    behind = se3.exp(np.array([0.0, 0.0, 0.0, 100.0, 0.0, 0.0]))
    points = points_before(rng, 30)
    assert fit_step(RIG, NOISE, RIG.project(points), after(points), start=behind) is None


def test_a_prior_rules_where_it_is_sure_and_not_where_it_is_not(rng):
    before, later = noisy_pairs(points_before(rng, 40), rng)
    other = se3.retract(MOTION, np.array([0.02, 0.01, -0.02, 0.1, 0.1, 0.1]))
    alone = fit(before, later, start=other)
    unsure = fit(before, later, start=other, prior=Prior(other, 1e6 * np.eye(6)))
    sure = fit(before, later, start=other, prior=Prior(other, 1e-14 * np.eye(6)))
    assert np.abs(se3.local(alone.prev_T_next, unsure.prev_T_next)).max() < 1e-6
    assert np.abs(se3.local(other, sure.prev_T_next)).max() < 1e-6
    assert unsure.dof == alone.dof + 6


def test_the_derivative_of_a_prior_is_that_of_finite_differences(rng):
    spread = rng.normal(size=(6, 6))
    prior = Prior(se3.exp(rng.normal(size=6)), spread @ spread.T + np.eye(6))
    motion = se3.retract(prior.prev_T_next, 0.5 * rng.normal(size=6))
    _, by_motion = prior.residual(motion)
    for axis in range(6):
        there, back = (prior.residual(se3.retract(motion, h * np.eye(6)[axis]))[0] for h in (1e-6, -1e-6))
        assert by_motion[:, axis] == pytest.approx((there - back) / 2e-6, abs=1e-7)


def test_where_no_track_goes_on_the_step_is_the_inertial_one():
    config, dataset = exact(seed=5)
    dataset = with_wrong_twist(dataset, 0.03)
    dataset = replace(dataset, sequence=dark(30, 1)(dataset.sequence))
    run = odometry(config, dataset)
    # Into the dark frame, and out of it.
    assert run.log.counts["inertial_steps"] == 2
    steps = se3.inverse(run.final.world_T_imu[:-1]) @ run.final.world_T_imu[1:]
    twist, _ = dataset.sequence.step_means()
    inertial = se3.exp(twist[1:] * np.diff(dataset.sequence.stamp)[:, None])
    off = np.abs(steps - inertial).max(axis=(1, 2))
    assert np.flatnonzero(off < 1e-12).tolist() == [29, 30]
    assert run.innovations.dof[30] == run.innovations.dof[31] == 0
    assert not run.used[dataset.sequence.frame_of == 30].any()
    problem, dt = make_problem(config, dataset), np.diff(dataset.sequence.stamp)[29]
    step = motion.integrate(twist[30], bias=problem.bias_mean, dt=dt, noise=problem.noise)
    # The bias that the twist may have is in it.
    own = step.cov + step.by_bias @ np.diag(problem.bias_sigma**2) @ step.by_bias.T
    carry = se3.adjoint(se3.inverse(steps[29]))
    assert run.final.covariances[30] == pytest.approx(
        carry @ run.final.covariances[29] @ carry.T + own, rel=1e-9
    )


def test_what_has_no_depth_is_gated_and_the_rest_goes_on():
    config, dataset = exact(seed=9)
    faulty = replace(dataset, sequence=negative_disparities(dataset.sequence))
    run = odometry(config, faulty)
    assert np.array_equal(run.gated, faulty.sequence.disparity < 0.5)
    assert not (run.used & run.gated).any()
    assert gap(run.final.world_T_imu, odometry(config, dataset).final.world_T_imu)[1] < 1e-6


def test_refused_observations_are_in_no_step():
    config, dataset = drive(seed=6)
    refused = dataset.sequence.track % 3 == 0
    run = odometry(config, dataset, usable=~refused)
    assert not run.used[refused].any()
    assert run.used[~refused].mean() > 0.9
    assert not np.array_equal(run.final.world_T_imu, odometry(config, dataset).final.world_T_imu)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "file", "length", "bound"),
    [("ds3", "03.npz", 1342.0, 8.0), ("kitti07", "0027.npz", 692.1, 8.0)],
)
def test_on_recorded_drives_it_is_a_few_metres_off(name, file, length, bound):
    recorded(file)
    config = configuration.load(CONFIGS / f"{name}.yaml")
    dataset = open_dataset(config.data, seed=0, data_dir=recorded(file).parent)
    run = odometry(config, dataset)
    assert path_length(run.final.world_T_imu) == pytest.approx(length, rel=0.01)
    scores = score_trajectory(run.frame, run.stamp, run.final.world_T_imu, dataset.reference)
    assert scores.headline.position.rmse < bound
