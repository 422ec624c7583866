"""OXTS folders made from simulated drives: what they hold is what comes out, at 10 Hz and at 100 Hz."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from tests.cli.test_compare import course_file
from vislam.base.errors import DataError
from vislam.comparison.config import DataConfig, InertialConfig
from vislam.comparison.open import open_dataset
from vislam.datasets.oxts import read_timestamps, with_oxts
from vislam.geometry import se3
from vislam.repair.inertial import NavigationFrameVelocity
from vislam.simulation import SimulationConfig, simulate
from vislam.simulation.path import DrivePath

DRIVE = SimulationConfig(frames=40, tracks_in_view=5, gyro_sigma=0.0, velocity_sigma=0.0)
START = datetime(2011, 9, 30, 12, 40, 25, tzinfo=UTC)


def write_stamps(path, stamp):
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = []
    for second in stamp:
        whole = int(second)
        nanoseconds = round(1e9 * (second - whole))
        lines.append(f"{START + timedelta(seconds=whole):%Y-%m-%d %H:%M:%S}.{nanoseconds:09d}\n")
    path.write_text("".join(lines))


def write_oxts(folder, stamp, twist):
    """Thirty numbers a sample; those that are not read are of a kind that would be noticed."""
    write_stamps(folder / "timestamps.txt", stamp)
    (folder / "data").mkdir()
    for k, row in enumerate(twist):
        numbers = np.full(30, 777.0)
        numbers[[17, 18, 19, 8, 9, 10]] = row
        (folder / "data" / f"{k:010d}.txt").write_text(" ".join(f"{number:.14g}" for number in numbers))
    return folder


def at_100_hz(seed):
    """A simulated drive, and its inertial samples at 100 Hz as OXTS states them."""
    sequence, truth = simulate(DRIVE, seed=seed, name="drive")
    path = DrivePath(DRIVE, np.random.default_rng(seed))
    stamp = np.arange(-0.05, sequence.stamp[-1] + 0.05, 0.01)
    twist = path.twist(stamp)
    twist[:, 5] = path.vertical_velocity(stamp)
    return sequence, truth, stamp, twist


def end_of(sequence):
    twist, _ = sequence.step_means()
    pose = np.eye(4)
    for step, dt in zip(twist[1:], np.diff(sequence.stamp), strict=True):
        pose = se3.retract(pose, dt * step)
    return pose


def test_an_unsynced_folder_has_raw_inertia_and_a_synced_one_none(tmp_path):
    sequence, _, stamp, twist = at_100_hz(seed=2)
    write_stamps(tmp_path / "camera.txt", 9.0 + sequence.stamp)
    folder = write_oxts(
        tmp_path / "oxts", 9.0 + np.delete(stamp, slice(100, 130)), np.delete(twist, slice(100, 130), 0)
    )
    read = with_oxts(sequence, folder, camera_timestamps=tmp_path / "camera.txt")
    assert np.array_equal(read.imu.stamp, read.inertial_stamp)
    assert np.allclose(read.imu.gyro, read.twist[:, :3])
    assert np.all(read.imu.accel == 777.0)
    assert read.imu.counts["imu_gaps"] == 1
    synced = write_oxts(tmp_path / "synced", sequence.stamp, sequence.twist)
    assert with_oxts(sequence, synced, camera_timestamps=None).imu is None


def test_a_synced_folder_gives_the_samples_of_the_frames(tmp_path):
    sequence, _ = simulate(DRIVE, seed=1, name="drive")
    folder = write_oxts(tmp_path / "oxts", sequence.stamp, sequence.twist)
    read = with_oxts(sequence, folder, camera_timestamps=None)
    assert np.allclose(read.twist, sequence.twist, rtol=1e-12, atol=1e-12)
    assert np.array_equal(read.inertial_stamp, sequence.stamp)
    assert np.array_equal(read.track, sequence.track)


def test_an_unsynced_folder_lies_in_the_recordings_clock(tmp_path):
    sequence, truth, stamp, twist = at_100_hz(seed=2)
    later = 3600.25
    write_stamps(tmp_path / "image_00" / "timestamps.txt", later + sequence.stamp)
    folder = write_oxts(tmp_path / "oxts", later + stamp, twist)
    shifted = replace(sequence, stamp=sequence.stamp + 50.0)
    read = with_oxts(shifted, folder, camera_timestamps=tmp_path / "image_00" / "timestamps.txt")
    assert np.allclose(read.inertial_stamp, stamp + 50.0, atol=2e-9)
    assert read.counts["inertial_samples"] == len(stamp)
    assert read.counts["inertial_longest_gap_ms"] == 10
    levelled = NavigationFrameVelocity().apply(read)
    assert np.allclose(levelled.vertical_velocity, twist[:, 5], rtol=1e-12)
    # The drive ends 50 m on; what is missing in height is the body's own heave.
    upright = replace(read, twist=np.column_stack([read.twist[:, :5], np.zeros(len(stamp))]))
    wanted = se3.inverse(truth.world_T_imu[0]) @ truth.world_T_imu[-1]
    assert np.linalg.norm(end_of(upright)[:3, 3] - wanted[:3, 3]) < 0.05


def test_repeated_stamps_are_dropped_and_counted(tmp_path):
    sequence, _, stamp, twist = at_100_hz(seed=3)
    again = np.sort(np.append(np.arange(len(stamp)), [7, 7, 90]))
    write_stamps(tmp_path / "camera.txt", 9.0 + sequence.stamp)
    folder = write_oxts(tmp_path / "oxts", 9.0 + stamp[again], twist[again])
    read = with_oxts(sequence, folder, camera_timestamps=tmp_path / "camera.txt")
    assert read.counts["inertial_duplicates"] == 3
    assert np.allclose(read.twist, twist, atol=1e-12)


@pytest.mark.parametrize("name", ["{}.txt", "{:03d}.txt", "{:010d}.txt", "{:020d}.txt"])
@pytest.mark.parametrize("mixed", [False, True])
def test_samples_are_in_the_order_of_their_numbers(tmp_path, name, mixed):
    sequence, _ = simulate(DRIVE, seed=1, name="drive")
    folder = write_oxts(tmp_path / "oxts", sequence.stamp, sequence.twist)
    for k in range(len(sequence)):
        other = name if not mixed or k % 3 else "{:06d}.txt"
        (folder / "data" / f"{k:010d}.txt").rename(folder / "data" / other.format(k))
    read = with_oxts(sequence, folder, camera_timestamps=None)
    assert np.allclose(read.twist, sequence.twist, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    "name", ["notes.txt", "1.5.txt", "-3.txt", "\N{SUPERSCRIPT TWO}.txt", "9" * 25 + ".txt"]
)
def test_a_name_that_is_no_number_is_one_line(tmp_path, name):
    sequence, _ = simulate(DRIVE, seed=1, name="drive")
    folder = write_oxts(tmp_path / "oxts", sequence.stamp, sequence.twist)
    (folder / "data" / name).write_text("1 " * 30)
    assert "must be named by the number of its sample" in refused(tmp_path, sequence, camera=False)


def test_two_files_of_one_number_are_one_line(tmp_path):
    sequence, _ = simulate(DRIVE, seed=1, name="drive")
    folder = write_oxts(tmp_path / "oxts", sequence.stamp, sequence.twist)
    (folder / "data" / "7.txt").write_text("1 " * 30)
    assert "must be the only sample of its number, got 0000000007.txt" in refused(
        tmp_path, sequence, camera=False
    )


def refused(tmp_path, sequence, *, camera=True):
    with pytest.raises(DataError) as caught:
        with_oxts(sequence, tmp_path / "oxts", camera_timestamps=tmp_path / "camera.txt" if camera else None)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_what_is_wrong_with_a_folder_is_one_line(tmp_path):
    sequence, _, stamp, twist = at_100_hz(seed=4)
    assert "got 0; name the folder oxts" in refused(tmp_path, sequence)
    folder = write_oxts(tmp_path / "oxts", 9.0 + stamp, twist)
    assert "name the camera_timestamps of the drive" in refused(tmp_path, sequence, camera=False)
    assert "camera.txt: cannot be read" in refused(tmp_path, sequence)
    write_stamps(tmp_path / "camera.txt", 9.0 + sequence.stamp[:-1])
    assert "camera.txt: must have a line for each of the 40 frames, got 39" in refused(tmp_path, sequence)
    write_stamps(tmp_path / "camera.txt", 9.0 + 1.1 * sequence.stamp)
    assert "must run with the recording's stamps, got 0.4" in refused(tmp_path, sequence)
    write_stamps(tmp_path / "camera.txt", 90.0 + sequence.stamp)
    assert "must cover the recording" in refused(tmp_path, sequence)
    write_stamps(tmp_path / "camera.txt", 9.0 + sequence.stamp)
    write_stamps(folder / "timestamps.txt", 9.0 + np.append(stamp[:-2], stamp[[-1, -2]]))
    assert "must increase, got 1 steps back, the first by 0.010000 s" in refused(tmp_path, sequence)
    write_stamps(folder / "timestamps.txt", 9.0 + stamp[:-1])
    assert f"each of the {len(stamp)} files in data, got {len(stamp) - 1}" in refused(tmp_path, sequence)
    (folder / "data" / "0000000003.txt").write_text("1 2 3")
    assert "0000000003.txt:1: must hold 30 finite numbers, got 3 columns" in refused(tmp_path, sequence)
    (folder / "data" / "0000000003.txt").write_text("")
    assert "must hold one line of 30 numbers, got 0" in refused(tmp_path, sequence)


@pytest.mark.parametrize(
    "text", ["2011-13-30 12:40:25.0", "12:40:25", "2011-09-30 12:40:25.0000000001", "\0"]
)
def test_what_is_no_stamp_is_named_with_its_line(tmp_path, text):
    (tmp_path / "t.txt").write_text(f"2011-09-30 12:40:25.066400000\n{text}\n")
    with pytest.raises(DataError, match=r"t\.txt:2: must be a stamp as"):
        read_timestamps(tmp_path / "t.txt")


def test_nanoseconds_are_kept(tmp_path):
    (tmp_path / "t.txt").write_text("2011-09-30 12:40:25.066400001\n2011-09-30 12:40:26\n")
    first, second = read_timestamps(tmp_path / "t.txt")
    assert second - first == 933_599_999


def test_a_config_finds_the_folder_beside_the_recording(tmp_path):
    course_file(tmp_path / "small.npz")
    inertial = InertialConfig(format="oxts", folder="drive/oxts")
    config = DataConfig(file="small.npz", inertial=inertial)
    with pytest.raises(DataError, match=r"drive/oxts: not found in .*put the drive's folder"):
        open_dataset(config, seed=0, data_dir=tmp_path)
    (tmp_path / "drive").mkdir()
    folder = write_oxts(tmp_path / "drive" / "oxts", 0.1 * np.arange(6), np.full((6, 6), 0.5))
    first = open_dataset(config, seed=0, data_dir=tmp_path).sequence
    assert np.allclose(first.twist, 0.5)
    (folder / "data" / "0000000000.txt").write_text("1 " * 30)
    assert open_dataset(config, seed=0, data_dir=tmp_path).sequence.digest != first.digest


def test_inertial_samples_without_a_recording_are_refused():
    with pytest.raises(ValueError, match="file must be given"):
        DataConfig(simulation=DRIVE, inertial=InertialConfig(format="oxts", folder="oxts"))
