"""Errors that all tracks share as variables of the graph: against the filter, and part by part."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from tests.shared_errors import SIGMA, every_shared_error
from tests.smoother.drives import BUILD, RIG, drive, exact, filtered, gap, member
from tests.smoother.test_covariance import relative
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import VerticalVelocityConfig
from vislam.comparison.open import open_dataset
from vislam.estimators.ekf import family
from vislam.estimators.loop import run
from vislam.estimators.smoother.factors import StereoFactors
from vislam.estimators.smoother.keys import X, landmark
from vislam.estimators.smoother.linear import linear_factor
from vislam.estimators.smoother.pixel_errors import PixelErrors
from vislam.estimators.smoother.world import GraphCovariances, Origin, ReportedWorld
from vislam.geometry import se3, so3
from vislam.models import Kernel
from vislam.models import track_noise as noise
from vislam.models.shared_errors import OF_PIXELS, SIZES

SMALL = {
    "camera_rotation": (1e-6, -2e-6, 1e-6),
    "disparity_offset_px": 1e-4,
    "principal_point_px": (1e-3, -1e-3),
    "focal_scale": 1e-6,
}
"""So small that nothing is beyond first order."""


@pytest.mark.parametrize("walk", [0.0, 0.5])
def test_filter_and_smoother_are_as_sure_where_all_is_linear(walk, monkeypatch):
    """With all of them on: covariances of poses and shared errors, at every frame and in the end."""
    ekf, smoothed = both(walk, monkeypatch)
    assert relative(smoothed.filtered.covariances, ekf.filtered.covariances) < 1e-6
    assert relative(smoothed.final.covariances[-1], ekf.filtered.covariances[-1]) < 1e-6
    for name in SIZES:
        assert np.allclose(smoothed.states[name].sigma[1:], ekf.states[name].sigma[1:], rtol=1e-6), name


@pytest.mark.parametrize("walk", [0.0, 0.5])
def test_filter_and_smoother_find_the_same_where_all_is_linear(walk, monkeypatch):
    """With all of them on, of small errors: poses and shared errors."""
    ekf, smoothed = both(walk, monkeypatch, **SMALL)
    for one in (smoothed.filtered, smoothed.final):
        assert max(gap(one.world_T_imu[-1:], ekf.filtered.world_T_imu[-1:])) < 1e-8
    for name in SIZES:
        one, other = smoothed.states[name], ekf.states[name]
        assert (np.abs(one.value - other.value) < 1e-6 * SIGMA[name]).all(), name
    # It is the estimates that agree, not the absence of any.
    for name in ("disparity_offset", "principal_point"):
        assert np.abs(ekf.states[name].value[-1]).max() > 1e-4 * SIGMA[name]


def both(walk, monkeypatch, **planted):
    """Runs of the filter and the smoother."""
    monkeypatch.setattr(noise, "_SMALLEST_BIAS_PX", 1e-7)
    config, dataset = exact(seed=3, frames=10, tracks_in_view=15, depth_max=20.0, **planted)
    config = replace(config, noise=replace(config.noise, **every_shared_error(walk)))
    ekf = filtered(config, dataset)
    options = {"pose_cov_every": 1, "marginals": "poses", "factorization": "qr"}
    smoothed = member("isam2", config, dataset, **options)
    assert smoothed.complete, smoothed.log.error
    return ekf, smoothed


@pytest.mark.parametrize("name", ["camera_rotation", "focal_scale"])
def test_one_of_them_alone(name, monkeypatch):
    monkeypatch.setattr(noise, "_SMALLEST_BIAS_PX", 1e-7)
    config, dataset = exact(seed=3, frames=6, tracks_in_view=12, depth_max=20.0)
    config = replace(config, noise=replace(config.noise, **{f"{name}_sigma": SIGMA[name]}))
    ekf, smoothed = filtered(config, dataset), member("batch", config, dataset, pose_cov_every=1)
    assert relative(smoothed.filtered.covariances, ekf.filtered.covariances) < 1e-4
    assert list(smoothed.states) == ["twist_bias", name]
    assert np.allclose(smoothed.states[name].sigma, ekf.states[name].sigma, rtol=1e-4)


PLANTED = {
    "camera_rotation": (0.003, -0.002, 0.002),
    "disparity_offset_px": 0.2,
    "principal_point_px": (1.0, -1.0),
    "focal_scale": 1e-3,
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "climb", [None, VerticalVelocityConfig(walk=0.05, tilt_sigma=0.05)], ids=["level", "climb"]
)
@pytest.mark.parametrize("name", ["isam2", "batch"])
def test_planted_errors_are_known_as_the_filter_knows_them(name, climb):
    """All poses from all data, the map, and their covariances, in the world of the body."""
    settings = {
        "frames": 40,
        "tracks_in_view": 25,
        "navigation_frame_velocity": True,
        "hills_m": 10.0,
        **PLANTED,
    }
    config, _ = drive(seed=8, pixel=0.1, **settings)
    data = replace(config.data, repair=replace(config.data.repair, navigation_frame_velocity=True))
    config = replace(
        config, data=data, noise=replace(config.noise, vertical_velocity=climb, **every_shared_error())
    )
    dataset = open_dataset(data, seed=8)
    eks = run(
        family.build_smoother(make_problem(config, dataset), {"gate": False}),
        dataset.sequence,
        pixel_sigma(config, dataset),
        name="eks",
    )
    found = member(name, config, dataset, marginals="all")
    assert found.complete, found.log.error
    sigma = [np.sqrt(np.diagonal(r.smoothed.cov[1:], axis1=1, axis2=2)) for r in (found, eks)]
    # The filter begins a track with its first observation, and linearises once.
    assert np.abs(sigma[0] / sigma[1] - 1.0).max() < 0.1
    apart = se3.local(eks.smoothed.world_T_imu[1:], found.smoothed.world_T_imu[1:])
    assert np.abs(apart / sigma[1]).max() < 0.5
    _, one, other = np.intersect1d(found.landmarks.track, eks.landmarks.track, return_indices=True)
    spread = [np.sqrt(np.trace(m.points_cov, axis1=1, axis2=2)) for m in (found.landmarks, eks.landmarks)]
    near = spread[1][other] < 1.0
    assert near.sum() > 20
    assert np.abs(spread[0][one] / spread[1][other] - 1.0)[near].max() < 0.1
    for key in (*OF_PIXELS, "camera_rotation"):
        off = found.states[key].value[-1] - eks.states[key].value[-1]
        assert (np.abs(off) < 0.5 * eks.states[key].sigma[-1]).all(), key
    # The observation that has two factors is counted once: as many squares as degrees of freedom.
    squares, freedom = found.fit
    assert abs(squares - freedom) < 4.0 * np.sqrt(2.0 * freedom)


def test_two_factors_are_the_stereo_factor(rng):
    shared = {name: prior for name, prior in problem_with_all().items() if name in OF_PIXELS}
    pixels, key = PixelErrors(RIG, shared, factorization="auto"), landmark(0, 8.0)
    z, sigma = np.array([300.0, 290.0, 200.0]), np.array([0.3, 0.4, 0.2])
    values = gtsam.Values()
    values.insert(X(0), gtsam.Pose3(se3.exp(0.1 * rng.normal(size=6))))
    values.insert(key, values.atPose3(X(0)).transformFrom(RIG.imu_T_cam[:3] @ [1.0, -0.5, 8.0, 1.0]))
    pixels.insert(values, 0)
    halves = StereoFactors(RIG, pixels=pixels).stereo(0, key, z=z, sigma=sigma)
    [whole] = StereoFactors(RIG).stereo(0, key, z=z, sigma=sigma)
    assert np.isclose(sum(factor.error(values) for factor in halves), whole.error(values), rtol=1e-10)
    wanted = whole.linearize(values).augmentedInformation()[:9, :9]
    found = np.zeros((9, 9))
    for factor in halves:
        jacobian, at = factor.linearize(values).jacobian()[0], 0
        columns = {}
        for name in list(factor.keys()):
            size = values.zeroVectors().dim(name)
            columns[name] = jacobian[:, at : at + size]
            at += size
        both = np.column_stack([columns[name] for name in list(whole.keys())])
        found += both.T @ both
    assert np.allclose(found, wanted, rtol=1e-8)


def problem_with_all():
    config, dataset = exact(seed=3, frames=2, tracks_in_view=5)
    noise_ = replace(config.noise, **every_shared_error())
    return make_problem(replace(config, noise=noise_), dataset).shared()


def test_a_linear_factor_of_many_variables_is_their_sum(rng):
    terms = {gtsam.symbol("w", i): rng.normal(size=(4, size)) for i, size in enumerate((4, 2, 3, 1, 3))}
    right, sigma = rng.normal(size=4), rng.uniform(0.1, 2.0, 4)
    factor, values = linear_factor(terms, right, sigma), gtsam.Values()
    left = np.zeros(4)
    for key, matrix in terms.items():
        x = rng.normal(size=matrix.shape[1])
        values.insert(key, x)
        left += matrix @ x
    assert np.isclose(factor.error(values), 0.5 * np.sum(((left - right) / sigma) ** 2), rtol=1e-9)
    assert factor.dim() == 4


@pytest.mark.parametrize("climb", [None, VerticalVelocityConfig()], ids=["level", "climb"])
@pytest.mark.parametrize("walks", [False, True])
def test_covariances_of_turned_poses_are_those_of_drawn_errors(climb, walks, short, short_config, rng):
    """By finite differences: errors of the graph's pose, of the first one and of the rotations."""
    settings = replace(short_config.noise, camera_rotation_sigma=1e-3)
    problem = make_problem(replace(short_config, noise=settings), short)
    world = ReportedWorld(problem)
    world.tilted = climb is not None
    if climb is not None:
        world._prior = np.zeros((6, 6))
    first = se3.exp(rng.normal(size=6)) if world.tilted else np.eye(4)
    pose, psi0 = se3.exp(rng.normal(size=6)), rng.normal(0.0, 0.3, 3)
    psi = rng.normal(0.0, 0.3, 3) if walks else psi0
    point = rng.normal(size=3)
    at = 6 if world.tilted else 0
    m = at + (6 if walks else 3)

    def moved(error):
        shared, own = error[:m], error[m : m + 6]
        base = first @ se3.exp(shared[:6]) if world.tilted else first
        one, other = psi0 + shared[at : at + 3], psi + shared[m - 3 : m]
        there = world.poses(Origin(base, one), pose @ se3.exp(own), other)
        p = world.points(Origin(base, one), (point + error[m + 6 :])[None])[0]
        return there, p

    here, p = moved(np.zeros(m + 9))
    step = 1e-6 * np.eye(m + 9)
    by_pose = np.column_stack([se3.local(here, moved(d)[0]) / 1e-6 for d in step])
    by_point = np.column_stack([(moved(d)[1] - p) / 1e-6 for d in step])
    root = rng.normal(size=(m + 9, m + 9))
    cov = root @ root.T
    origin, g = Origin(first, psi0), slice(0, m)
    own, of_point = slice(m, m + 6), slice(m + 6, m + 9)
    known = GraphCovariances(cov[None, own, own], cov[None, own, g], cov[g, g])
    found = world.pose_covariances(origin, pose[None], psi[None], known)[0]
    assert np.allclose(found, by_pose @ cov @ by_pose.T, rtol=1e-4, atol=1e-3)
    g = slice(0, at + 3)
    known = GraphCovariances(cov[None, of_point, of_point], cov[None, of_point, g], cov[g, g])
    found = world.point_covariances(origin, p[None], known)[0]
    by_point[:, at + 3 : m + 6] = 0.0
    assert np.allclose(found, by_point @ cov @ by_point.T, rtol=1e-4, atol=1e-3)
    if world.tilted:
        up = first[:3, :3].T @ [0.0, 0.0, 1.0]
        assert np.allclose(world.up(origin), so3.exp(psi0) @ up)


# These reject some of them by name.
@pytest.mark.parametrize("name", sorted(BUILD.keys() - {"batch_gnc", "batch_schur", "isam2_between"}))
def test_all_members_say_that_they_estimate_them(name, short, short_config):
    config = replace(short_config, noise=replace(short_config.noise, **every_shared_error()))
    said = BUILD[name](make_problem(config, short), {}).information
    assert {said[key.replace("_", " ")] for key in SIZES} == {"estimated"}


@pytest.mark.parametrize(
    ("name", "options", "words"),
    [
        ("isam2", {}, "which kernel would weigh"),
        ("batch_gnc", {}, r"estimators\.batch_gnc\.final would weigh"),
        ("batch", {"factors": "smart"}, r"estimators\.batch\.factors would weigh"),
        ("isam2_between", {}, "motion: between has no variables"),
    ],
)
def test_what_would_weigh_halves_is_refused_by_name(name, options, words, short, short_config):
    kernel = Kernel(4.0) if name == "isam2" else None
    problem = replace(make_problem(short_config, short), disparity_offset_sigma=0.3, kernel=kernel)
    with pytest.raises(ConfigError, match=rf"estimators\.{name}.*{words}.*disparity_offset_sigma_px"):
        BUILD[name](problem, options)
    assert BUILD["isam2"](replace(problem, disparity_offset_sigma=0.0, camera_rotation_sigma=1e-3), {})
