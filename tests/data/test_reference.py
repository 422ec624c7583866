"""Reference files: every format, the axes they end in, and what is wrong with bad ones."""

import logging

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from vislam.base.errors import ConfigError, DataError
from vislam.datasets.settings import ReferenceConfig
from vislam.datasets.trajectories import load_reference
from vislam.geometry import se3

MOUNTED = se3.exp(np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0]))
STAMP = 100.0 + 0.1 * np.arange(10)


def read(path, form, **options):
    config = ReferenceConfig(file=path.name, format=form, name="r", limits="l", **options)
    return load_reference(path, config, imu_T_cam=MOUNTED, stamp=STAMP)


def poses(count, generator):
    turn = Rotation.random(count, rng=generator).as_matrix()
    return se3.from_rotation_translation(turn, generator.uniform(-9, 9, (count, 3)))


def stamped(stamp, pose):
    quaternion = Rotation.from_matrix(pose[:, :3, :3]).as_quat()
    return np.column_stack([stamp, pose[:, :3, 3], quaternion])


def test_kitti_poses_are_turned_upright(tmp_path):
    pose = np.tile(np.eye(4), (3, 1, 1))
    pose[:, :3, 3] = [[0, 0, 0], [1, 2, 3], [2, 4, 6]]
    np.savetxt(tmp_path / "poses.txt", pose[:, :3].reshape(3, 12))
    reference = read(tmp_path / "poses.txt", "kitti", pose_of="left_camera", up="-y")
    # Camera axes are right, down, forward; ours are forward, left, up.
    assert np.allclose(reference.position[1], [3, -1, -2])
    assert np.allclose(se3.inverse(reference.pose[1]) @ reference.pose[2], se3.inverse(pose[1]) @ pose[2])
    assert np.array_equal(reference.imu_T_point, MOUNTED)


def test_kitti_poses_of_the_body_are_taken_as_they_are(tmp_path, rng):
    pose = poses(12, rng)
    np.savetxt(tmp_path / "poses.txt", pose[:, :3].reshape(12, 12))
    reference = read(tmp_path / "poses.txt", "kitti")
    assert np.allclose(reference.pose, pose[:10])
    assert np.array_equal(reference.imu_T_point, np.eye(4))


def test_kitti360_poses_name_their_frames(tmp_path, rng):
    pose = poses(3, rng)
    table = np.column_stack([[2, 5, 11], pose[:, :3].reshape(3, 12)])
    np.savetxt(tmp_path / "poses.txt", table, fmt=["%d", *["%.9f"] * 12])
    reference = read(tmp_path / "poses.txt", "kitti360")
    assert reference.frame.tolist() == [2, 5]
    assert np.allclose(reference.pose, pose[:2])


def test_a_planar_reference_keeps_the_frames_of_the_recording(tmp_path):
    np.savetxt(tmp_path / "xy.txt", [[1, 5.0, 6.0], [4, 7.0, 8.0], [12, 0.0, 0.0]], header="frame x y")
    reference = read(tmp_path / "xy.txt", "planar_xy")
    assert reference.planar
    assert reference.frame.tolist() == [1, 4]


def test_a_planar_reference_has_no_other_way_up(tmp_path):
    with pytest.raises(ValueError, match="up must be z"):
        read(tmp_path / "xy.txt", "planar_xy", up="-y")


def test_stamps_go_to_the_nearest_frame_and_each_frame_has_one(tmp_path, rng, caplog):
    stamp = np.array([99.0, 99.99, 100.004, 100.15, 100.31, 100.312, 100.9, 101.0])
    pose = poses(len(stamp), rng)
    np.savetxt(tmp_path / "a.tum", stamped(stamp, pose), fmt="%.12f")
    with caplog.at_level(logging.INFO):
        reference = read(tmp_path / "a.tum", "tum")
    assert reference.frame.tolist() == [0, 3, 9]
    assert np.allclose(reference.pose, pose[[2, 4, 6]])
    assert "8 rows, 5 belong to no frame" in caplog.text
    wide = read(tmp_path / "a.tum", "tum", max_time_difference=0.06)
    assert set(reference.frame) < set(wide.frame)


def test_euroc_is_read_with_its_header_and_scalar_first(tmp_path, rng):
    pose = poses(10, rng)
    quaternion = Rotation.from_matrix(pose[:, :3, :3]).as_quat()
    lines = ["#timestamp [ns], p_RS_R_x [m], and so on"]
    for k in range(10):
        nanoseconds = round(1e9 * STAMP[k])
        numbers = [*pose[k, :3, 3], quaternion[k, 3], *quaternion[k, :3], 0.1, 0.2]
        lines.append(f"{nanoseconds}," + ",".join(f"{number:.12f}" for number in numbers))
    (tmp_path / "data.csv").write_text("\n".join(lines) + "\n")
    reference = read(tmp_path / "data.csv", "euroc")
    assert np.allclose(reference.pose, pose)
    assert reference.frame.tolist() == list(range(10))


GOOD = "1 0 0 0 0 1 0 0 0 0 1 0\n"
BAD = {
    "too few columns": ("planar_xy", "1 2\n3 4\n", r":1: must hold 3 finite numbers, got 2 columns"),
    "ragged": ("planar_xy", "1 2 3\n\n2 3\n", ":3: must hold 3 finite numbers, got 2 columns"),
    "a word": ("planar_xy", "# frame x y\n1 a 2\n", ":2: must hold 3 finite numbers, got 'a'"),
    "NaN": ("planar_xy", "1 nan 2\n3 4 5\n", ":1: must hold 3 finite numbers, got nan"),
    "absurd": ("planar_xy", "1 1e300 2\n3 4 5\n", ":1: must hold 3 finite numbers, got 1e"),
    "empty": ("planar_xy", "", "must have 2 lines of planar_xy or more, got 0"),
    "half a frame": ("planar_xy", "0 1 1\n1.5 2 3\n", ":2: must have a whole number for its frame, got 1.5"),
    "a negative frame": (
        "planar_xy",
        "-1 1 1\n1 2 3\n",
        ":1: must have a frame or a stamp from 0 on, got -1",
    ),
    "a frame twice": ("planar_xy", "1 1 1\n1 2 3\n", ":2: must have frames or stamps that increase"),
    "frames of another drive": ("planar_xy", "70 1 1\n71 2 3\n", "does it belong to this recording?"),
    "far away": ("planar_xy", "1 1e12 1\n2 2 3\n", ":1: must have a position within 1e"),
    "a matrix that scales": ("kitti", GOOD + GOOD.replace("1", "2"), ":2: must have a rotation"),
    "a mirror": ("kitti", GOOD + "-" + GOOD, r":2: must have a rotation .* determinant -1"),
    "a quaternion of norm 2": (
        "tum",
        "100 0 0 0 0 0 0 2\n",
        ":1: must have a quaternion of norm 1, got norm 2",
    ),
    "stamps that fall": (
        "tum",
        "100.2 0 0 0 0 0 0 1\n100.1 0 0 0 0 0 0 1\n",
        ":2: must have frames or stamps that increase, got 100.1",
    ),
    "another clock": (
        "tum",
        "5 0 0 0 0 0 0 1\n6 0 0 0 0 0 0 1\n",
        "are its stamps in the clock of the recording?",
    ),
}


@pytest.mark.parametrize("case", sorted(BAD))
def test_bad_references_are_one_line(tmp_path, case):
    form, text, message = BAD[case]
    (tmp_path / "bad.txt").write_text(text)
    with pytest.raises(DataError, match=r"bad\.txt") as caught:
        read(tmp_path / "bad.txt", form, strict=True)
    assert caught.match(message)
    assert "\n" not in str(caught.value)


def test_an_unknown_format_is_named(tmp_path):
    from vislam.comparison.config import parse

    with pytest.raises(ConfigError, match=r"format.*'planar_xy', 'kitti', 'kitti360', 'tum', 'euroc'"):
        parse(ReferenceConfig, {"file": "f", "format": "kitti_cam", "name": "r", "limits": "l"})
