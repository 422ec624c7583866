"""The tracks that come with GTSAM: read in our conventions, odometry as stated, a reference that fits."""

import numpy as np
import pytest

from vislam.base.errors import DataError
from vislam.comparison.config import DataConfig, PackagedConfig
from vislam.comparison.open import open_dataset
from vislam.core.sequence import piecewise_constant
from vislam.datasets import kitti00 as gtsam_stereo
from vislam.datasets.kitti00_batch import batch_poses
from vislam.datasets.text import read_table
from vislam.geometry import se3
from vislam.repair.pixels import Disparity
from vislam.simulation import SimulationConfig, simulate


@pytest.fixture
def quick(monkeypatch):
    """The data without the batch solution, which takes seconds: visual odometry stands for it."""
    monkeypatch.setattr(gtsam_stereo, "batch_poses", lambda sequence, world_T_imu: world_T_imu)


def test_samples_of_constant_twist_keep_every_step(rng):
    stamp = np.cumsum(rng.uniform(0.05, 0.3, 30))
    steps = rng.standard_normal((29, 6)) * [1, 1, 1, 20, 20, 20]
    inertial_stamp, twist = piecewise_constant(stamp, steps)
    assert np.all(np.diff(inertial_stamp) > 0)
    sequence, _ = simulate(SimulationConfig(frames=30, tracks_in_view=2), seed=1, name="s")
    values = {**vars(sequence), "stamp": stamp, "inertial_stamp": inertial_stamp, "twist": twist}
    values["vertical_velocity"] = np.full(len(twist), np.nan)
    means, _ = type(sequence)(**values).step_means()
    # A step takes in a ten millionth of its neighbours' difference.
    assert np.allclose(means[1:], steps, rtol=0, atol=5e-6)
    assert np.allclose(means[1:, :3], steps[:, :3], rtol=0, atol=1e-6)
    assert np.array_equal(means[0], steps[0])


def test_the_tracks_are_read_in_our_conventions(quick):
    sequence, reference = gtsam_stereo.load_kitti00(gyro_sigma=0.0, velocity_sigma=0.0, seed=0)
    assert (len(sequence), sequence.observations, len(np.unique(sequence.track))) == (135, 88_781, 26_136)
    assert not sequence.synthetic
    # The files state each observation's point in the camera as well.
    table, _ = read_table(gtsam_stereo._file("VO_stereo_factors00.txt"), columns=8)
    given = table[np.lexsort((table[:, 1], table[:, 0]))]
    points = sequence.rig.back_project(sequence.z)
    near = given[:, 7] < 40.0
    assert np.allclose(points[near], given[near, 5:], rtol=2e-3, atol=0.01)
    # Over the first second the car goes forward, which is x, and turns about z but a little.
    assert reference.position[10, 0] > 5.0
    assert np.abs(reference.position[10, 1:]).max() < 0.3
    dt = np.diff(sequence.stamp)
    assert np.allclose(np.unique(dt.round(6)), [0.1037, 0.2074])
    twist, _ = sequence.step_means()
    reached = np.eye(4)
    for step, length in zip(twist[1:], dt, strict=True):
        reached = se3.retract(reached, length * step)
    assert np.allclose(reached, reference.pose[-1], atol=1e-4)


@pytest.mark.slow
def test_the_noise_of_the_odometry_is_what_was_asked_for(quick):
    clean, _ = gtsam_stereo.load_kitti00(gyro_sigma=0.0, velocity_sigma=0.0, seed=0)
    noisy, _ = gtsam_stereo.load_kitti00(gyro_sigma=0.03, velocity_sigma=0.2, seed=1)
    again, _ = gtsam_stereo.load_kitti00(gyro_sigma=0.03, velocity_sigma=0.2, seed=1)
    other, _ = gtsam_stereo.load_kitti00(gyro_sigma=0.03, velocity_sigma=0.2, seed=2)
    added = (noisy.twist - clean.twist)[::2] * np.sqrt(np.diff(clean.stamp)[:, None] / 0.1037)
    assert np.std(added[:, :3]) == pytest.approx(0.03, rel=0.15)
    assert np.std(added[:, 3:]) == pytest.approx(0.2, rel=0.15)
    assert again.digest == noisy.digest != other.digest


def test_a_dataset_of_them_says_what_it_is(quick):
    packaged = PackagedConfig(name="kitti00")
    dataset = open_dataset(DataConfig(packaged=packaged), seed=0)
    assert "made odometry" in dataset.sequence.name
    assert "MADE ODOMETRY" in dataset.notes[0]
    assert "not independent" in dataset.notes[0]
    assert dataset.reference.name == "batch solution of the same tracks"
    with pytest.raises(ValueError, match="give it alone"):
        DataConfig(packaged=packaged, file="03.npz")


def test_a_gtsam_without_the_files_is_named(monkeypatch, tmp_path):
    monkeypatch.setattr(gtsam_stereo, "find_spec", lambda name: None)
    with pytest.raises(DataError, match=r"VO_camera_poses00\.txt: not among the example data"):
        gtsam_stereo.load_kitti00(gyro_sigma=0.0, velocity_sigma=0.0, seed=0)


def test_the_batch_solution_finds_a_simulated_drive_from_a_wrong_start(rng):
    config = SimulationConfig(frames=15, tracks_in_view=40, pixel_sigma_px=0.1)
    sequence, truth = simulate(config, seed=1, name="drive")
    sequence = Disparity(minimum_px=4.0).apply(sequence)
    from_first = se3.inverse(truth.world_T_imu[0]) @ truth.world_T_imu
    wrong = from_first @ se3.exp(0.05 * rng.standard_normal((15, 6)))
    wrong[0] = from_first[0]
    solved = batch_poses(sequence, wrong)
    assert np.allclose(solved[0], np.eye(4), atol=1e-9)
    assert np.abs(solved[:, :3, 3] - from_first[:, :3, 3]).max() < 0.05
    assert np.abs(wrong[:, :3, 3] - from_first[:, :3, 3]).max() > 0.1


@pytest.mark.slow
def test_the_batch_solution_of_the_real_tracks_is_near_their_visual_odometry():
    _, reference = gtsam_stereo.load_kitti00(gyro_sigma=0.0, velocity_sigma=0.0, seed=0)
    _, odometry = gtsam_stereo._visual_odometry(gtsam_stereo._CAMERA)
    apart = np.linalg.norm(reference.position - odometry[:, :3, 3], axis=1)
    assert 0.1 < apart[-1] < 1.0
    length = np.linalg.norm(np.diff(reference.position, axis=0), axis=1).sum()
    assert length == pytest.approx(110.6, abs=0.5)
