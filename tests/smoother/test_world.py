"""The world of the first pose, in which a smoother reports although the graph's z is the vertical."""

from dataclasses import replace

import numpy as np
import pytest

from tests.smoother.drives import drive, gap, member
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import VerticalVelocityConfig
from vislam.comparison.open import open_dataset
from vislam.estimators.ekf import family
from vislam.estimators.loop import run
from vislam.estimators.smoother.world import GraphCovariances, Origin, ReportedWorld
from vislam.geometry import se3

FRAMES = 40
TILT = 0.05


@pytest.fixture(scope="module")
def climbing():
    """A short drive over hills whose vertical velocity is used, a first pose tilted by 0.05 rad expected."""
    settings = {"frames": FRAMES, "tracks_in_view": 25, "navigation_frame_velocity": True, "hills_m": 10.0}
    config, _ = drive(seed=8, pixel=0.1, **settings)
    data = replace(config.data, repair=replace(config.data.repair, navigation_frame_velocity=True))
    noise = replace(config.noise, vertical_velocity=VerticalVelocityConfig(walk=0.05, tilt_sigma=TILT))
    return replace(config, data=data, noise=noise), open_dataset(data, seed=8)


@pytest.fixture(scope="module")
def smoothed(climbing):
    return member("batch", *climbing, marginals="all", pose_cov_every=5)


@pytest.fixture(scope="module")
def filtered(climbing):
    config, dataset = climbing
    estimator = family.build_smoother(make_problem(config, dataset), {})
    return run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="eks")


def test_filter_and_smoother_report_in_the_same_world(smoothed, filtered):
    assert np.allclose(smoothed.final.world_T_imu[0], np.eye(4), atol=1e-12)
    for estimate in ("filtered", "smoothed"):
        one, other = (run.poses(estimate).world_T_imu for run in (smoothed, filtered))
        angle, distance = gap(one, other)
        assert angle < 2e-4, estimate
        assert distance < 0.01, estimate
    assert np.linalg.norm(smoothed.up - filtered.up) < 1e-3
    assert abs(np.linalg.norm(smoothed.up) - 1.0) < 1e-12


def test_their_covariances_are_of_the_same_errors(smoothed, filtered):
    for estimate in ("filtered", "smoothed"):
        one, other = (run.poses(estimate).covariances for run in (smoothed, filtered))
        known = np.isfinite(one).all(axis=(1, 2)) & np.isfinite(other).all(axis=(1, 2))
        known[0] = False
        assert known.sum() >= (FRAMES - 1) // 5 - 1, estimate
        sigma = [np.sqrt(np.diagonal(cov[known], axis1=1, axis2=2)) for cov in (one, other)]
        assert np.abs(sigma[0] / sigma[1] - 1.0).max() < 0.15, estimate
    # The tilt of the graph's world, of 0.05 rad, would be in each of them.
    assert sigma[0][:, :2].max() < 0.1 * TILT


def test_covariances_are_those_of_drawn_errors(climbing, rng):
    config, dataset = climbing
    world = ReportedWorld(make_problem(config, dataset))
    prior = np.diag(np.square(make_problem(config, dataset).first_pose_sigma))
    root = 1e-3 * rng.standard_normal((15, 15))
    cov = root @ root.T
    first, pose = se3.exp(rng.standard_normal(6)), se3.exp(rng.standard_normal(6))
    point = rng.standard_normal(3)
    errors = rng.standard_normal((50_000, 15)) @ root.T
    first_T_world = se3.inverse(first @ se3.exp(errors[:, :6]))
    tried = first_T_world @ pose @ se3.exp(errors[:, 6:12])
    here, origin = se3.inverse(first) @ pose, Origin(first, np.zeros(3))
    assert np.allclose(world.poses(origin, pose, np.zeros(3)), here)
    back = se3.adjoint(se3.inverse(here))
    known = GraphCovariances(cov[None, 6:12, 6:12], cov[None, 6:12, :6], cov[:6, :6])
    pose_cov = world.pose_covariances(origin, pose[None], np.zeros((1, 3)), known)[0]
    drawn = np.cov(se3.local(here, tried).T)
    assert np.allclose(pose_cov - back @ prior @ back.T, drawn, atol=0.02 * drawn.max())
    moved = np.einsum("nij,nj->ni", first_T_world[:, :3, :3], point + errors[:, 12:])
    moved += first_T_world[:, :3, 3]
    at = world.points(origin, point[None])
    known = GraphCovariances(cov[None, 12:, 12:], cov[None, 12:, :6], cov[:6, :6] - prior)
    point_cov = world.point_covariances(origin, at, known)[0]
    drawn = np.cov(moved.T)
    assert np.allclose(point_cov, drawn, atol=0.02 * drawn.max())
