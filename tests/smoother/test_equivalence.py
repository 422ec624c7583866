"""Estimators that must agree: members of the family with each other, with the filter, with SciPy."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

from tests.conftest import recorded
from tests.smoother.drives import drive, filtered, gap, member
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import load
from vislam.comparison.open import open_dataset
from vislam.core.step import TWIST_BIAS
from vislam.geometry import se3
from vislam.models import track_noise as noise

CONFIGS = Path(__file__).parents[2] / "configs"


@pytest.mark.slow
def test_isam2_that_relinearises_to_the_end_equals_batch():
    config, dataset = drive(seed=9, frames=120, tracks_in_view=30)
    incremental = member("isam2", config, dataset, final_iterations=20)
    batch = member("batch", config, dataset)
    assert incremental.complete
    assert batch.complete
    angle, distance = gap(incremental.final.world_T_imu, batch.final.world_T_imu)
    assert angle < 1e-7
    assert distance < 1e-6


@pytest.mark.slow
def test_isam2_that_relinearises_to_the_end_equals_batch_on_the_recording():
    config = load(CONFIGS / "ds3.yaml")
    dataset = open_dataset(config.data, seed=0, data_dir=recorded("03.npz").parent, allow_substitute=False)
    dataset = replace(dataset, sequence=dataset.sequence.first(300))
    incremental = member("isam2", config, dataset, final_iterations=20)
    batch = member("batch", config, dataset)
    assert incremental.complete
    assert batch.complete
    angle, distance = gap(incremental.final.world_T_imu, batch.final.world_T_imu)
    assert angle < 1e-5
    assert distance < 1e-3


def most_probable(config, dataset):
    """Poses of the least squares problem that the model is, by SciPy, from dead reckoning."""
    problem, sequence = make_problem(config, dataset), dataset.sequence
    rig, levels = problem.rig, problem.noise
    frames = list(sequence.frames(pixel_sigma(config, dataset)))
    count = len(frames)
    tracks, which = np.unique(sequence.track, return_inverse=True)
    twist = np.array([frame.odometry.twist for frame in frames])[1:]
    dt = np.array([frame.dt for frame in frames])[1:, None]
    start = np.array([np.eye(4)] * count)
    for k in range(1, count):
        start[k] = start[k - 1] @ se3.exp(dt[k - 1] * twist[k - 1])
    sigma, frame_of, z = pixel_sigma(config, dataset), sequence.frame_of, sequence.z
    _, first = np.unique(sequence.track, return_index=True)
    in_camera = rig.back_project(z[first])
    points = se3.transform((start @ rig.imu_T_cam)[frame_of[first]], in_camera[:, None])[:, 0]

    def unpack(x):
        poses = start @ se3.exp(x[: 6 * count].reshape(count, 6))
        bias = x[6 * count : 12 * count - 6].reshape(count - 1, 6)
        return poses, bias, x[12 * count - 6 :].reshape(-1, 3)

    def residuals(x):
        poses, bias, landmarks = unpack(x)
        moved = se3.local(poses[:-1], poses[1:])
        cameras = se3.inverse(poses @ rig.imu_T_cam)[frame_of]
        seen = rig.project(se3.transform(cameras, landmarks[which][:, None])[:, 0])
        parts = (
            se3.log(poses[0]) / problem.first_pose_sigma,
            (bias[0] - problem.bias_mean) / problem.bias_sigma,
            (moved - dt * (twist - bias)) / (np.sqrt(dt) * levels.twist),
            np.diff(bias, axis=0) / (np.sqrt(dt[:-1]) * levels.bias_walk),
            (z - seen) / sigma,
        )
        return np.concatenate([part.reshape(-1) for part in parts])

    begin = np.concatenate([np.zeros(12 * count - 6), points.reshape(-1)])
    found = least_squares(residuals, begin, jac="3-point", x_scale="jac", ftol=1e-15, xtol=1e-12, gtol=1e-12)
    poses, bias, landmarks = unpack(found.x)
    return poses, bias, dict(zip(tracks.tolist(), landmarks, strict=True))


def test_batch_equals_least_squares_of_scipy():
    config, dataset = drive(
        seed=5,
        frames=7,
        tracks_in_view=10,
        depth_max=25.0,
        loss_probability=0.0,
        gyro_bias=(0.003, -0.002, 0.004),
    )
    length = np.bincount(dataset.sequence.track)
    dataset = replace(dataset, sequence=dataset.sequence.select(length[dataset.sequence.track] > 1))
    batch = member("batch", config, dataset)
    assert batch.used.all()
    assert 8 <= len(batch.landmarks.track) <= 20
    poses, bias, landmarks = most_probable(config, dataset)
    assert max(gap(batch.final.world_T_imu, poses)) < 1e-7
    found = np.array([landmarks[int(track)] for track in batch.landmarks.track])
    assert np.allclose(batch.landmarks.points_world, found, atol=1e-6)
    # That of the newest step is the posterior, too, but for its linearisation.
    found = batch.states[TWIST_BIAS].value
    assert np.allclose(found[-1], bias[-1], atol=0.01 * np.array([0.02] * 3 + [0.05] * 3))


@pytest.mark.parametrize(("window", "wildfire", "within"), [(1000, 0.0, 1e-9), (5, 0.1, 1e-3)])
def test_a_lag_longer_than_the_drive_changes_nothing(window, wildfire, within):
    """Nothing at all where no variable rests and no change counts as small, as in the fixed-lag smoother."""
    config, dataset = drive(seed=2, frames=40, tracks_in_view=25)
    same = {
        "final": "as_is",
        "relinearize_every": 3,
        "factorization": "qr",
        "wildfire_threshold": wildfire,
        # Small enough for much to be relinearised.
        "pose_threshold_rad": 1e-5,
        "pose_threshold_m": 1e-4,
        "landmark_threshold": 1e-3,
    }
    whole = member("isam2", config, dataset, window=window, **same)
    lagged = member("fixed_lag", config, dataset, lag_s=1e3, **same)
    assert whole.complete
    assert lagged.complete
    assert max(gap(whole.filtered.world_T_imu, lagged.filtered.world_T_imu)) < within
    assert max(gap(whole.final.world_T_imu, lagged.final.world_T_imu)) < within
    biases = [run.states[TWIST_BIAS].value for run in (whole, lagged)]
    assert np.allclose(*biases, atol=within)
    assert np.array_equal(whole.used, lagged.used)
    once = member("isam2_norelin", config, dataset)
    assert gap(once.filtered.world_T_imu, lagged.filtered.world_T_imu)[1] > 10.0 * within


@pytest.mark.parametrize("name", ["isam2_norelin", "isam2"])
def test_the_last_pose_is_the_filters_where_all_is_nearly_linear(name, monkeypatch):
    # The filter never takes the error of a match for zero; that is half of this noise.
    monkeypatch.setattr(noise, "_SMALLEST_BIAS_PX", 1e-7)
    config, dataset = drive(
        seed=6,
        frames=25,
        path="straight",
        tracks_in_view=25,
        depth_max=20.0,
        pixel=0.002,
        gyro=2e-6,
        velocity=2e-5,
    )
    # Where the first pose is fixed. Else the filter believes to learn where it is, which nothing tells, as
    # much as it would from noise of any level: Jacobians change by as much as the noise.
    config = replace(config, noise=replace(config.noise, first_pose_sigma=(1e-6,) * 6))
    ekf = filtered(config, dataset)
    smoothed = member(name, config, dataset, wildfire_threshold=0.0)
    assert smoothed.complete
    off = se3.local(ekf.final.world_T_imu[-1], smoothed.final.world_T_imu[-1])
    assert np.all(np.abs(off) < 0.01 * np.sqrt(np.diagonal(ekf.final.covariances[-1])))


def test_smart_factors_and_batch_with_the_same_noise_in_rows_and_columns_are_close():
    config, dataset = drive(seed=4, frames=25, tracks_in_view=25)
    sigma = np.full((dataset.sequence.observations, 3), 0.3)
    batch = member("batch", config, dataset, sigma=sigma)
    smart = member("batch", config, dataset, sigma=sigma, factors="smart")
    assert smart.complete
    angle, distance = gap(batch.final.world_T_imu, smart.final.world_T_imu)
    # Smart factors triangulate linearly, which is not where the residuals are least.
    assert angle < 1e-5
    assert distance < 3e-4
    assert np.array_equal(batch.landmarks.track, smart.landmarks.track)
    assert np.allclose(batch.landmarks.points_world, smart.landmarks.points_world, atol=3e-3)
