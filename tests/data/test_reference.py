"""Reference files: the axes they end in, and what is wrong with bad ones."""

import numpy as np
import pytest

from vislam.data.reference import load_reference
from vislam.errors import DataError
from vislam.geometry import se3

PLAIN = {"name": "r", "limits": "l", "imu_T_cam": np.eye(4), "frames": 10}


def test_kitti_poses_are_turned_upright(tmp_path):
    pose = np.tile(np.eye(4), (3, 1, 1))
    pose[:, :3, 3] = [[0, 0, 0], [1, 2, 3], [2, 4, 6]]
    np.savetxt(tmp_path / "poses.txt", pose[:, :3].reshape(3, 12))
    reference = load_reference(tmp_path / "poses.txt", "kitti_cam", **PLAIN)
    # Camera axes are right, down, forward; ours are forward, left, up.
    assert np.allclose(reference.position[1], [3, -1, -2])
    assert np.allclose(se3.inverse(reference.pose[1]) @ reference.pose[2], se3.inverse(pose[1]) @ pose[2])


def test_a_planar_reference_keeps_the_frames_of_the_recording(tmp_path):
    np.savetxt(tmp_path / "xy.txt", [[1, 5.0, 6.0], [4, 7.0, 8.0], [12, 0.0, 0.0]], header="frame x y")
    reference = load_reference(tmp_path / "xy.txt", "planar_xy", **PLAIN)
    assert reference.planar
    assert reference.frame.tolist() == [1, 4]


@pytest.mark.parametrize("text", ["1 2\n3 4\n", "1 a 2\n", "", "1 nan 2\n3 4 5\n"])
@pytest.mark.filterwarnings("ignore:loadtxt")
def test_bad_references_are_one_line(tmp_path, text):
    (tmp_path / "xy.txt").write_text(text)
    with pytest.raises(DataError, match=r"xy\.txt: reference must"):
        load_reference(tmp_path / "xy.txt", "planar_xy", **PLAIN)
