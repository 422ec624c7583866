"""Covariances: of the newest pose, of all poses and landmarks in the end."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from tests.smoother.drives import drive, exact, filtered, gap, member
from vislam.core.step import TWIST_BIAS
from vislam.estimators.smoother import batch
from vislam.estimators.smoother.batch import Drive
from vislam.estimators.smoother.keys import X
from vislam.models import track_noise as noise


def relative(found, wanted):
    """Largest difference of covariances ``(..., d, d)`` in standard deviations of the second."""
    sigma = np.sqrt(np.diagonal(wanted, axis1=-2, axis2=-1))
    scale = sigma[..., :, None] * sigma[..., None, :]
    return np.abs((found - wanted) / scale).max()


@pytest.mark.parametrize("name", ["isam2", "isam2_norelin", "batch"])
def test_without_errors_the_newest_poses_covariance_is_the_filters(name, monkeypatch):
    # The filter never takes the error of a match for zero, or the landmark's fourth number had no variance.
    monkeypatch.setattr(noise, "_SMALLEST_BIAS_PX", 1e-7)
    config, dataset = exact(seed=3, frames=30, tracks_in_view=25, depth_max=20.0)
    ekf = filtered(config, dataset)
    smoothed = member(name, config, dataset, pose_cov_every=1)
    assert smoothed.complete
    assert relative(smoothed.filtered.covariances[0], ekf.filtered.covariances[0]) < 1e-6
    # A track waits for its second view, and one seen only once tells nothing about a pose.
    assert relative(smoothed.filtered.covariances, ekf.filtered.covariances) < 1e-6
    assert np.allclose(smoothed.states[TWIST_BIAS].sigma, ekf.states[TWIST_BIAS].sigma, rtol=1e-6)


SMOOTH = (0.09, 0.09, 0.05, 0.3, 0.2, 0.2)


@pytest.mark.parametrize(
    ("acceleration", "within"), [(None, 1e-6), (SMOOTH, 3e-3)], ids=["odometry", "smooth"]
)
def test_filter_and_smoother_know_the_direction_of_the_velocity_alike(acceleration, within, monkeypatch):
    """Its covariance, and what of a small error of it both find: with 1e-5 rad nothing is beyond first
    order."""
    monkeypatch.setattr(noise, "_SMALLEST_BIAS_PX", 1e-7)
    config, dataset = exact(seed=3, frames=20, tracks_in_view=25, depth_max=20.0)
    sigma = (*config.noise.bias_sigma[:4], 1e-4, 1e-4)
    more = {"velocity_direction_sigma": 0.02, "bias_sigma": sigma, "acceleration_density": acceleration}
    config = replace(config, noise=replace(config.noise, **more))
    ekf, smoothed = filtered(config, dataset), member("isam2", config, dataset, pose_cov_every=1)
    assert relative(smoothed.filtered.covariances, ekf.filtered.covariances) < within
    sequence = dataset.sequence
    twist = sequence.twist.copy()
    twist[:, 4:] += twist[:, 3:4] * [1e-5, -2e-5]
    spoilt = replace(dataset, sequence=replace(sequence, twist=twist))
    ekf, smoothed = filtered(config, spoilt), member("isam2", config, spoilt)
    assert max(gap(smoothed.filtered.world_T_imu, ekf.filtered.world_T_imu)) < within


def test_within_its_lag_the_fixed_lag_smoother_knows_as_much(monkeypatch):
    monkeypatch.setattr(noise, "_SMALLEST_BIAS_PX", 1e-7)
    config, dataset = exact(seed=3, frames=30, tracks_in_view=25, depth_max=20.0)
    ekf = filtered(config, dataset)
    # Marginals are exact where all is linearised at the truth, but for tracks longer than the lag.
    smoothed = member("fixed_lag", config, dataset, lag_s=1.0, pose_cov_every=1)
    assert smoothed.complete
    assert relative(smoothed.filtered.covariances, ekf.filtered.covariances) < 1e-6


def test_covariances_are_given_only_where_they_were_asked_for():
    config, dataset = drive(seed=3, frames=15, tracks_in_view=15)
    seldom = member("isam2", config, dataset, pose_cov_every=5)
    known = np.isfinite(seldom.filtered.covariances).all(axis=(1, 2))
    assert np.flatnonzero(known).tolist() == [0, 5, 10]
    assert seldom.landmarks.points_cov is None
    never = member("isam2", config, dataset)
    assert not np.isfinite(never.filtered.covariances).any()


@pytest.mark.parametrize("name", ["isam2", "batch"])
def test_final_marginals_are_those_of_the_whole_information_matrix(name, monkeypatch):
    config, dataset = drive(seed=3, frames=15, tracks_in_view=15)
    asked = []
    marginals = Drive.marginals

    def spied(self, values, *rest, **more):
        asked.append((self.graph(), values, [track.key for track in self.tracks]))
        return marginals(self, values, *rest, **more)

    monkeypatch.setattr(Drive, "marginals", spied)
    run = member(name, config, dataset, marginals="all")
    [(graph, values, landmarks)] = asked
    poses = [X(k) for k in range(15)]
    ordering, start, at = gtsam.Ordering(), {}, 0
    for key in list(values.keys()):
        ordering.push_back(key)
        start[key] = at
        at += len(values.zeroVectors().at(key))
    cov = np.linalg.inv(graph.linearize(values).hessian(ordering)[0])
    wanted = np.array([cov[start[key] : start[key] + 6, start[key] : start[key] + 6] for key in poses])
    assert relative(run.final.covariances, wanted) < 1e-6
    wanted = np.array([cov[start[key] : start[key] + 3, start[key] : start[key] + 3] for key in landmarks])
    assert len(wanted) == len(run.landmarks.track)
    assert relative(run.landmarks.points_cov, wanted) < 1e-6


def test_the_newest_poses_marginal_is_the_last_of_the_final_ones():
    config, dataset = exact(seed=3, frames=20, tracks_in_view=20, depth_max=20.0)
    run = member("isam2", config, dataset, pose_cov_every=1, marginals="poses")
    assert relative(run.filtered.covariances[-1], run.final.covariances[-1]) < 1e-6
    assert run.landmarks.points_cov is None


def test_marginals_that_cholesky_refuses_come_from_qr(monkeypatch):
    config, dataset = drive(seed=3, frames=15, tracks_in_view=15)
    usual = member("isam2", config, dataset, marginals="all")

    def refuse(*_, **__):
        raise np.linalg.LinAlgError("the information is not positive definite")

    monkeypatch.setattr(batch.Drive, "system", refuse)
    other = member("isam2", config, dataset, marginals="all")
    assert relative(other.final.covariances, usual.final.covariances) < 1e-6
    assert relative(other.landmarks.points_cov, usual.landmarks.points_cov) < 1e-6
