"""Raw inertia of KITTI 00 from GTSAM: where the tracks lie on its clock, and what is no inertia of theirs."""

import numpy as np
import pytest

from tests.inertial import IMU, drive
from vislam.base.errors import DataError
from vislam.core.imu import ImuSeries
from vislam.datasets import kitti00, kitti00_inertia
from vislam.datasets.gyro_alignment import align_gyro
from vislam.datasets.recording import Opening
from vislam.datasets.settings import Kitti00
from vislam.geometry import se3, so3

PLANTED = 1000.137
"""What the clock of the samples shows at the drive's zero [s]."""


def turns(pose):
    return so3.log(pose[:-1, :3, :3].transpose(0, 2, 1) @ pose[1:, :3, :3])


def among_others(seeds, own):
    """Samples of several drives one after the other, that of the seed ``own`` at the planted offset."""
    at = seeds.index(own)
    parts, shift = [], [PLANTED + 12.0 * (place - at) for place in range(len(seeds))]
    for seed, begin in zip(seeds, shift, strict=True):
        imu = drive(seed=seed, frames=60, path="town")[1].sequence.imu
        inside = (imu.stamp >= -0.05) & (imu.stamp < 11.0)
        parts.append(np.column_stack([imu.stamp + begin, imu.gyro, imu.accel])[inside])
    table = np.concatenate(parts)
    return ImuSeries.of(table[:, 0], table[:, 1:4], table[:, 4:])


@pytest.mark.parametrize("own", [2, 3])
def test_a_planted_offset_is_found_within_its_interval(own):
    series = among_others([1, 2, 3, 4], own)
    dataset = drive(seed=own, frames=60, path="town")[1]
    found = align_gyro(dataset.sequence.stamp, turns(dataset.reference.pose), series)
    assert abs(found.offset - PLANTED) < max(3.0 * found.sigma, 1e-3)
    assert found.sigma < 0.03
    # White noise of the gyro over a step, and its mounting is known.
    assert found.residual < 3.0 * IMU.gyro_density / np.sqrt(0.1)
    assert found.residual < 0.5 * found.elsewhere
    assert found.steps == 59


def test_a_drive_that_begins_before_the_samples_is_found_by_the_rest():
    series = among_others([2, 3], 2)
    dataset = drive(seed=2, frames=60, path="town")[1]
    late = series.stamp >= PLANTED + 1.25
    series = ImuSeries(series.stamp[late], series.gyro[late], series.accel[late])
    stamp = dataset.sequence.stamp
    found = align_gyro(stamp, turns(dataset.reference.pose), series)
    assert found.offset == pytest.approx(PLANTED, abs=max(3.0 * found.sigma, 1e-3))
    assert found.steps == 59 - 13
    assert kitti00_inertia.covered_from(stamp + found.offset, series) == 13


def test_samples_of_another_drive_are_no_inertia_of_the_tracks():
    dataset = drive(seed=5, frames=60, path="town")[1]
    series = among_others([1, 2, 3, 4], 1)
    with pytest.raises(DataError, match=r"other\.txt: must have the rates of the stereo tracks.*imu: false"):
        kitti00_inertia.find_drive(dataset.sequence.stamp, dataset.reference.pose, series, where="other.txt")


def test_the_vertical_comes_from_the_mean_force(rng):
    dataset = drive(seed=2, frames=60, path="town")[1]
    tilt = se3.from_rotation_translation(so3.exp(0.2 * rng.standard_normal(3)), np.zeros(3))
    sequence, pose = dataset.sequence, tilt @ dataset.reference.pose
    level = kitti00_inertia.level(sequence.stamp, pose, sequence.imu)
    up = level @ tilt[:3, :3] @ np.array([0.0, 0.0, 1.0])
    # The bias of the accelerometer is drawn with 0.05 m/s^2 and more.
    assert np.degrees(np.arccos(up[2])) < 1.5


@pytest.fixture(scope="module")
def recording():
    """Real tracks with inertia; visual odometry stands for the batch solution, which takes seconds."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(kitti00, "batch_poses", lambda sequence, world_T_imu: world_T_imu)
        return kitti00.read(Kitti00(imu=True), Opening([], 0))


def test_the_inertia_of_kitti_00_is_that_of_its_tracks(recording):
    sequence = recording.sequence
    # The frames before the first complete second are left out.
    assert len(sequence) == 121
    assert sequence.counts["frames_before_inertia"] == 14
    assert sequence.stamp[0] == pytest.approx(14 * 0.1037)
    # It is a recording of its own: its observations are counted from the first of these frames.
    assert np.array_equal(sequence.row, np.arange(sequence.observations))
    steps = list(sequence.imu.steps(sequence.stamp))
    assert all(step.known.all() for step in steps)
    seen = turns(recording.reference.pose)
    felt = np.array([np.sum(step.dt[:, None] * step.mean_gyro, axis=0) for step in steps[1:]])
    assert [np.corrcoef(one, other)[0, 1] > 0.97 for one, other in zip(seen.T, felt.T, strict=True)] == [
        True
    ] * 3
    assert np.sqrt(np.mean((seen - felt - (seen - felt).mean(axis=0)) ** 2)) < 1e-3
    # Its world is level: over the drive the car stays on its wheels, and gravity is what it measures.
    tilt = np.degrees(np.arccos(recording.reference.pose[:, 2, 2]))
    assert tilt.max() < 6.0
    force = np.array([step.mean_accel.mean(axis=0) for step in steps[1:]])
    assert (recording.reference.pose[1:, :3, :3] @ force[:, :, None])[:, 2, 0].mean() == pytest.approx(
        9.81, abs=0.1
    )


def test_its_notes_say_how_the_offset_was_found(recording):
    (note,) = recording.notes
    assert "frame 0 of the tracks is 0.52" in note
    assert "95 % interval" in note
    assert "the run begins at frame 14" in note
    assert "MADE ODOMETRY" in note
    assert "levelled by the mean of the accelerometer" in note


def test_a_file_that_is_no_table_is_named(tmp_path):
    path = tmp_path / "imu.txt"
    path.write_text("Time dt\n1 2\n3 x\n")
    with pytest.raises(DataError, match=r"imu\.txt: must be a table of 8 numbers"):
        kitti00_inertia.read_inertia(path)
    path.write_text("Time dt\n1 2\n")
    with pytest.raises(DataError, match=r"imu\.txt: must have 8 finite numbers a line .*got 2 columns"):
        kitti00_inertia.read_inertia(path)
