"""The smoother: its factor's Jacobians, where landmarks start, and that it agrees with the filter."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from tests.conftest import from_first
from vislam.comparison import make_problem, pixel_sigma
from vislam.config import Config, DataConfig
from vislam.data.source import Dataset, open_dataset
from vislam.ekf import EkfEstimator, EkfOptions
from vislam.errors import DivergedError
from vislam.estimator import run
from vislam.geometry import se3
from vislam.repair import RepairConfig
from vislam.repair.pixels import Disparity
from vislam.repair.tracks import Interruptions
from vislam.sensors import StereoRig
from vislam.simulation import SimulationConfig
from vislam.smoother import Isam2Estimator, Isam2Options
from vislam.smoother.factors import twist_factor
from vislam.smoother.keys import B, X
from vislam.smoother.triangulation import triangulate


def test_twist_factor_jacobians(rng):
    factor = twist_factor(X(0), B(0), X(1), twist=rng.normal(size=6), dt=0.1, cov=np.eye(6))
    poses, bias = [gtsam.Pose3(se3.exp(rng.normal(size=6))) for _ in range(2)], 0.1 * rng.normal(size=6)

    def values(x0, b, x1):
        out = gtsam.Values()
        out.insert(X(0), poses[0].retract(x0))
        out.insert(B(0), bias + b)
        out.insert(X(1), poses[1].retract(x1))
        return out

    jacobian, _ = factor.linearize(values(*np.zeros((3, 6)))).jacobian()
    for column, error in enumerate(1e-6 * np.eye(18)):
        there = factor.unwhitenedError(values(*error.reshape(3, 6)))
        back = factor.unwhitenedError(values(*-error.reshape(3, 6)))
        assert np.allclose(jacobian[:, column], (there - back) / 2e-6, atol=1e-7)


def test_triangulation_finds_the_point_and_waits_for_the_far_one(rng):
    rig = StereoRig(500.0, 500.0, 320.0, 200.0, 0.5, np.eye(4))
    points = np.array([[1.0, 0.5, 12.0], [20.0, 3.0, 400.0], [-2.0, 1.0, 8.0]])
    poses = se3.exp(np.array([[0, 0, 0, 0, 0, 0.4 * k] for k in range(4)], dtype=float))
    z = np.stack([rig.project(se3.transform(se3.inverse(pose), points)) for pose in poses], axis=1)
    z[2, 3] += [40.0, 40.0, 0.0]
    start = triangulate(rig, np.broadcast_to(poses, (3, 4, 4, 4)), z, np.full((3, 4, 3), 0.5), clear=5.0)
    assert start.ready.tolist() == [True, False, False]
    assert np.allclose(start.points_world[0], points[0], atol=1e-6)


def test_it_agrees_with_the_filter_where_all_is_nearly_linear(short_config: Config):
    nearly = SimulationConfig(
        frames=25,
        path="straight",
        tracks_in_view=25,
        depth_max=20.0,
        pixel_sigma_px=0.05,
        gyro_sigma=1e-4,
        velocity_sigma=1e-3,
    )
    root = np.sqrt(nearly.period)
    noise = replace(
        short_config.noise,
        pixel_sigma_px=0.05,
        drift_px=0.0,
        match_px=0.0,
        twist_density=(1e-4 * root,) * 3 + (1e-3 * root,) * 3,
    )
    config = replace(
        short_config, noise=noise, data=DataConfig(simulation=nearly, repair=RepairConfig(consensus=None))
    )
    dataset = open_dataset(config.data, seed=6)
    problem, sigma = make_problem(config, dataset), pixel_sigma(config, dataset)
    filtered = run(EkfEstimator(problem, EkfOptions(gate=False)), dataset.sequence, sigma, name="ekf")
    options = Isam2Options(huber=None, final_iterations=3)
    smoothed = run(Isam2Estimator(problem, options), dataset.sequence, sigma, name="isam2")
    assert filtered.complete
    assert smoothed.complete
    gap = se3.local(filtered.world_T_imu[-1], smoothed.world_T_imu[-1])
    claimed = np.sqrt(np.diagonal(filtered.pose_cov[-1]))
    # The last pose of filter and smoother is the same posterior; a fifth of a sigma is linearisation.
    assert np.all(np.abs(gap) < 0.2 * claimed)


def test_smoothing_beats_filtering_on_the_past(short_config: Config):
    config = replace(
        short_config, data=DataConfig(simulation=SimulationConfig(frames=120, pixel_sigma_px=0.3))
    )
    dataset = open_dataset(config.data, seed=9)
    problem, sigma = make_problem(config, dataset), pixel_sigma(config, dataset)
    smoothed = run(Isam2Estimator(problem, Isam2Options()), dataset.sequence, sigma, name="isam2")

    def error(poses):
        return np.sqrt(np.mean((poses - from_first(dataset.reference.pose))[:, :3, 3] ** 2))

    assert smoothed.complete
    assert error(smoothed.world_T_imu) < 0.05
    assert error(smoothed.world_T_imu) <= 1.2 * error(smoothed.world_T_imu_causal)


def test_refused_observations_are_not_fused(short: Dataset, short_config: Config):
    problem, sigma = make_problem(short_config, short), pixel_sigma(short_config, short)
    refused = np.arange(short.sequence.observations) % 7 == 0
    for estimator in (EkfEstimator(problem, EkfOptions()), Isam2Estimator(problem, Isam2Options())):
        result = run(estimator, short.sequence, sigma, name="any", refused=refused)
        assert result.complete
        assert result.used.any()
        assert not np.any(result.used & refused)


def harsh(short_config: Config, *, frames=80, **faults):
    simulation = SimulationConfig(frames=frames, tracks_in_view=30, **faults)
    repairs = RepairConfig(consensus=None, disparity=Disparity(row_difference_px=200.0))
    data = DataConfig(simulation=simulation, repair=repairs)
    config = replace(short_config, data=data)
    return config, open_dataset(config.data, seed=8)


@pytest.mark.parametrize("share", [0.05, 0.2, 0.4])
def test_wrong_associations_do_not_end_the_run(short_config: Config, share):
    config, dataset = harsh(short_config, outlier_probability=share)
    estimator = Isam2Estimator(make_problem(config, dataset), Isam2Options())
    result = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="isam2")
    assert result.complete
    assert np.all(np.isfinite(result.world_T_imu))


def test_twenty_frames_without_tracks_are_bridged(short_config: Config):
    config, dataset = harsh(short_config, pixel_sigma_px=0.3)
    frame = dataset.sequence.frame_of
    dark = dataset.sequence.select((frame < 30) | (frame >= 50))
    sigma = np.full((dark.observations, 3), 0.3)
    estimator = Isam2Estimator(make_problem(config, dataset), Isam2Options())
    result = run(estimator, Interruptions().apply(dark), sigma, name="isam2")
    assert result.complete
    error = result.world_T_imu[:, :3, 3] - from_first(dataset.reference.pose)[:, :3, 3]
    assert np.abs(error).max() < 1.0


def test_a_step_that_cannot_be_solved_is_rescued_and_counted(short_config: Config, monkeypatch):
    config, dataset = harsh(short_config, frames=40, pixel_sigma_px=0.3)
    estimator = Isam2Estimator(make_problem(config, dataset), Isam2Options(checkpoint_frames=10))
    solve = Isam2Estimator._solve
    failed = []

    def fails_once(self, graph, values, parameters, where):
        if where == "frame 26" and not failed:
            failed.append(where)
            raise DivergedError("planted")
        return solve(self, graph, values, parameters, where)

    monkeypatch.setattr(Isam2Estimator, "_solve", fails_once)
    result = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="isam2")
    assert result.complete
    assert result.counts["rescues"] == 1
    assert result.counts["frames_without_camera"] == 7
    assert len(result.world_T_imu) == 40
    error = result.world_T_imu[:, :3, 3] - from_first(dataset.reference.pose)[:, :3, 3]
    assert np.abs(error).max() < 0.5


def test_a_step_that_never_can_be_solved_fails_and_keeps_the_rest(short_config: Config, monkeypatch):
    config, dataset = harsh(short_config, frames=40)
    solve = Isam2Estimator._solve

    def fails(self, graph, values, parameters, where):
        if where == "frame 26":
            raise DivergedError("planted at frame 26")
        return solve(self, graph, values, parameters, where)

    monkeypatch.setattr(Isam2Estimator, "_solve", fails)
    estimator = Isam2Estimator(make_problem(config, dataset), Isam2Options())
    result = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="isam2")
    assert not result.complete
    assert "planted at frame 26" in result.error
    assert len(result.world_T_imu) == 26
