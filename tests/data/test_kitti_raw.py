"""KITTI raw drives, unrectified and rectified, written as the data set has them."""

from datetime import datetime, timedelta

import numpy as np
import pytest

from tests.frontend.studio import cameras, pair
from vislam.base.errors import DataError
from vislam.core.images import StampedPoses
from vislam.datasets.images import open_images
from vislam.datasets.oxts_poses import oxts_poses
from vislam.geometry import se3

FRAMES = 6
BEGIN = datetime(2011, 9, 26, 14, 5, 35)


def stamps(seconds):
    lines = [
        (BEGIN + timedelta(seconds=second)).strftime("%Y-%m-%d %H:%M:%S.%f") + "000" for second in seconds
    ]
    return "\n".join(lines) + "\n"


def numbers(values):
    return " ".join(f"{value:.12e}" for value in np.ravel(values))


def calibration(folder):
    """Files of the day, of the cameras of the studio."""
    left, right, _, _ = cameras()
    made = pair()
    rig = made.rig
    lines = ["calib_time: 09-Jan-2012 13:57:47"]
    for side, camera, turn, shift in (
        ("00", left, made.rect_R_left, 0.0),
        ("01", right, made.rect_R_right, -rig.fx * rig.baseline),
    ):
        matrix = [[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]]
        projection = [[rig.fx, 0, rig.cx, shift], [0, rig.fy, rig.cy, 0], [0, 0, 1, 0]]
        lines += [
            f"S_{side}: {camera.width} {camera.height}",
            f"K_{side}: {numbers(matrix)}",
            f"D_{side}: {numbers([*camera.coefficients, 0.0])}",
            f"R_rect_{side}: {numbers(turn)}",
            f"S_rect_{side}: {camera.width} {camera.height}",
            f"P_rect_{side}: {numbers(projection)}",
        ]
    (folder / "calib_cam_to_cam.txt").write_text("\n".join(lines) + "\n")
    grey_T_imu = se3.from_rotation_translation(made.rect_R_left.T, np.zeros(3)) @ rig.cam_T_imu
    (folder / "calib_velo_to_cam.txt").write_text(
        f"R: {numbers(grey_T_imu[:3, :3])}\nT: {numbers(grey_T_imu[:3, 3])}\n"
    )
    (folder / "calib_imu_to_velo.txt").write_text(f"R: {numbers(np.eye(3))}\nT: 0 0 0\n")


def packet(second, *, speed=10.0):
    """Going north-east and up, without turning."""
    row = np.zeros(30)
    metres = speed * second * np.array([0.6, 0.8])
    row[0] = 49.0 + np.degrees(metres[1] / 6378137.0)
    row[1] = 8.4 + np.degrees(metres[0] / (6378137.0 * np.cos(np.radians(49.0))))
    row[2], row[5] = 112.0 + 0.1 * second, np.arctan2(0.8, 0.6)
    row[6], row[7], row[8], row[10] = 0.8 * speed, 0.6 * speed, speed, 0.1
    return row


@pytest.fixture
def drive(tmp_path):
    calibration(tmp_path)
    folder = tmp_path / "2011_09_26_drive_0001_extract"
    for side in ("00", "01"):
        (folder / f"image_{side}" / "data").mkdir(parents=True)
        (folder / f"image_{side}" / "timestamps.txt").write_text(stamps(0.1 * np.arange(FRAMES)))
        for number in range(FRAMES):
            (folder / f"image_{side}" / "data" / f"{number:010d}.png").touch()
    (folder / "oxts" / "data").mkdir(parents=True)
    (folder / "oxts" / "timestamps.txt").write_text(stamps(0.01 * np.arange(61)))
    # Thinned: each file is named by the line that its stamp is on.
    for number in range(0, 61, 7):
        (folder / "oxts" / "data" / f"{number:010d}.txt").write_text(numbers(packet(0.01 * number)) + "\n")
    return folder


def test_cameras_are_those_of_the_day(drive):
    recording, made = open_images(drive), pair()
    pixels = np.array([[20.0, 30.0], [160.0, 100.0], [300.0, 190.0]])
    assert np.allclose(recording.pair.rectify_left(pixels), made.rectify_left(pixels), atol=1e-6)
    assert np.allclose(recording.pair.rectify_right(pixels), made.rectify_right(pixels), atol=1e-6)
    assert recording.pair.rig.baseline == pytest.approx(made.rig.baseline)
    assert np.allclose(recording.pair.rig.imu_T_cam, made.rig.imu_T_cam, atol=1e-9)


def test_synced_images_are_rectified_already(drive):
    synced = drive.rename(drive.with_name("2011_09_26_drive_0001_sync"))
    recording = open_images(synced)
    pixels = np.array([[20.0, 30.0], [160.0, 100.0]])
    assert np.allclose(recording.pair.rectify_left(pixels), pixels)
    assert np.allclose(recording.pair.rectify_right(pixels), pixels)


def test_the_folder_above_will_do(drive):
    assert open_images(drive.parent).name == drive.name


def test_missing_images_take_their_pair_with_them(drive):
    (drive / "image_01" / "data" / "0000000002.png").unlink()
    (drive / "image_00" / "data" / "0000000003.png").unlink()
    recording = open_images(drive)
    assert [path.stem[-1] for path in recording.left.paths] == ["0", "1", "4", "5"]
    assert np.allclose(np.diff(recording.stamp), [0.1, 0.3, 0.1])
    assert recording.counts["images_missing_left"] == recording.counts["images_missing_right"] == 1


def test_poses_of_thinned_samples_lie_at_the_images(drive):
    recording = open_images(drive)
    assert isinstance(recording.reference, StampedPoses)
    assert recording.inertia is not None
    assert recording.counts["inertial_samples"] == 9
    expected = 10.0 * (recording.reference.stamp - recording.stamp[0])
    position = recording.reference.world_T_imu[:, :3, 3]
    assert np.allclose(position, expected[:, None] * [0.6, 0.8, 0.01], atol=1e-3)
    assert np.allclose(recording.inertia.velocity[:, 0], 10.0)


def test_gyro_and_accelerometer_are_those_about_the_body_s_own_axes(drive):
    for number in range(0, 61, 7):
        row = packet(0.01 * number)
        # ax, ay, az, af, al, au; wx, wy, wz, wf, wl, wu: the second triples are levelled.
        row[11:23] = 0.01 * number + np.arange(11, 23)
        (drive / "oxts" / "data" / f"{number:010d}.txt").write_text(numbers(row))
    found = open_images(drive)
    series, second = found.inertia.series, 0.01 * np.arange(0, 61, 7)
    assert np.allclose(series.stamp - found.stamp[0], second, rtol=0.0, atol=1e-6)
    assert np.allclose(series.accel, second[:, None] + [11, 12, 13])
    assert np.allclose(series.gyro, second[:, None] + [17, 18, 19])


def test_samples_are_put_in_order_and_duplicates_go(drive):
    second = 0.01 * np.arange(61)
    second[[7, 14]] = second[[14, 7]]
    second[28] = second[21]
    (drive / "oxts" / "timestamps.txt").write_text(stamps(second))
    found = open_images(drive)
    assert np.all(np.diff(found.inertia.stamp) > 0.0)
    assert found.counts["inertial_samples"] == 8
    assert found.counts["inertial_duplicates"] == found.counts["inertial_out_of_order"] == 1


def test_a_gap_of_thinned_samples_is_counted_and_not_known(drive):
    for number in (28, 35, 42):
        (drive / "oxts" / "data" / f"{number:010d}.txt").unlink()
    found = open_images(drive)
    series = found.inertia.series
    assert series.counts["imu_gaps"] == 1
    assert sum(step.missing for step in series.steps(found.stamp)) == pytest.approx(0.28, abs=1e-6)


@pytest.mark.parametrize(("column", "unit"), [(11, r"m/s\^2"), (19, "rad/s")])
def test_samples_that_no_sensor_measures_are_one_line(drive, column, unit):
    row = packet(0.07)
    row[column] = 1e5
    (drive / "oxts" / "data" / "0000000007.txt").write_text(numbers(row))
    with pytest.raises(DataError, match=f"oxts: .* {unit}, got 100000: is it in another unit"):
        open_images(drive)


def test_no_pose_is_made_up_in_a_gap():
    at = np.array([0.0, 0.1, 1.0, 1.1])
    table = np.array([packet(second) for second in at])
    found = oxts_poses(at, table, np.array([-0.1, 0.05, 0.5, 1.05, 2.0]))
    assert found.stamp.tolist() == [0.05, 1.05]


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda d: (d.parent / "calib_cam_to_cam.txt").unlink(), "calib_cam_to_cam.txt: cannot be read"),
        (
            lambda d: (d.parent / "calib_imu_to_velo.txt").write_text("R: 1 2\n"),
            "R must be 9 finite numbers, got 2",
        ),
        (lambda d: (d / "image_01" / "timestamps.txt").unlink(), "timestamps.txt: cannot be read"),
        (
            lambda d: (d / "oxts" / "data" / "0000000014.txt").write_text("1 2 3"),
            "0000000014.txt:1: must hold 30 finite numbers, got 3 columns",
        ),
        (
            lambda d: (d / "oxts" / "data" / "0000000014.txt").write_text("x " * 30),
            "0000000014.txt:1: must hold 30 finite numbers, got 'x'",
        ),
        (
            lambda d: (d / "oxts" / "timestamps.txt").write_text(stamps([0.0, 0.1]) + "soon\n"),
            "timestamps.txt:3: must be a stamp as",
        ),
        (
            lambda d: (d / "oxts" / "data" / "0000000099.txt").write_text(numbers(packet(0.99))),
            "sample 99 is none of them",
        ),
    ],
)
def test_what_cannot_be_used_is_one_line(drive, spoil, said):
    spoil(drive)
    with pytest.raises(DataError, match=said) as caught:
        open_images(drive)
    assert "\n" not in str(caught.value)
