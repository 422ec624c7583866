"""KITTI odometry sequences, written as the benchmark has them."""

import struct

import numpy as np
import pytest

from vislam.base.errors import DataError
from vislam.datasets.image_size import image_size
from vislam.datasets.images import is_images, open_images
from vislam.geometry import se3
from vislam.models import CAMERA_AXES

cv2 = pytest.importorskip("cv2")
FRAMES = 5
POSES = np.array([se3.exp(k * np.array([0.01, -0.02, 0.005, 0.1, -0.02, 1.0])) for k in range(FRAMES)])


def projection(x):
    return f"700 0 300 {x} 0 700 90 0 0 0 1 0"


@pytest.fixture
def sequence(tmp_path):
    folder = tmp_path / "sequences" / "07"
    for side in "0123":
        (folder / f"image_{side}").mkdir(parents=True)
        for k in range(FRAMES):
            picture = np.full((180, 600), 10 * k, np.uint8)
            assert cv2.imwrite(str(folder / f"image_{side}" / f"{k:06d}.png"), picture)
    lines = [f"P{side}: {projection(x)}" for side, x in zip("0123", (0, -350, 35, -315), strict=True)]
    (folder / "calib.txt").write_text("\n".join(lines) + "\n")
    (folder / "times.txt").write_text("".join(f"{0.1036 * k:e}\n" for k in range(FRAMES)))
    (tmp_path / "poses").mkdir()
    rows = "\n".join(" ".join(f"{value:e}" for value in pose[:3].ravel()) for pose in POSES)
    (tmp_path / "poses" / "07.txt").write_text(rows + "\n")
    return folder


def test_pairs_stamps_rig_and_poses(sequence):
    assert is_images(sequence)
    recording = open_images(sequence)
    assert recording.name == "kitti_odometry_07"
    assert np.allclose(recording.stamp, 0.1036 * np.arange(FRAMES))
    assert recording.pair.rig.baseline == pytest.approx(0.5)
    assert (recording.pair.left.width, recording.pair.left.height) == (600, 180)
    assert recording.inertia is None
    reference = recording.reference
    # A step ahead of the camera is one along x of the body, in a world with z up.
    assert np.allclose(reference.world_T_imu[0], np.eye(4), atol=1e-6)
    assert np.allclose(reference.world_T_imu[:, :3, 3], POSES[:, :3, 3] @ CAMERA_AXES.T, atol=1e-5)
    assert reference.name == "KITTI odometry poses"


def test_the_colour_pair_stands_beside_the_camera_of_the_poses(sequence):
    for side in "01":
        for path in (sequence / f"image_{side}").iterdir():
            path.unlink()
        (sequence / f"image_{side}").rmdir()
    recording = open_images(sequence)
    # x in camera 2 is x in camera 0 plus 35 / 700 m: it stands 0.05 m to the left, which is along y.
    cam0_T_cam2 = np.eye(4)
    cam0_T_cam2[0, 3] = -0.05
    turn = np.eye(4)
    turn[:3, :3] = CAMERA_AXES
    body = cam0_T_cam2 @ np.linalg.inv(turn)
    expected = np.linalg.inv(body) @ POSES @ body
    assert np.allclose(recording.reference.world_T_imu, expected, atol=1e-5)


def test_images_that_are_missing_are_counted_and_poses_stay_with_their_stamps(sequence):
    (sequence / "image_1" / "000002.png").unlink()
    recording = open_images(sequence)
    assert recording.counts["images_missing_right"] == 1
    assert np.allclose(recording.stamp, 0.1036 * np.array([0, 1, 3, 4]))
    assert np.isin(recording.stamp, recording.reference.stamp).all()


@pytest.mark.parametrize(
    ("file", "text", "said"),
    [
        ("sequences/07/calib.txt", "P0: 1 2 3\n", r"calib.txt: P0 must be 12 finite numbers, got 3"),
        (
            "sequences/07/calib.txt",
            f"P0: {projection(0)}\nP1: {projection(350)}\n",
            r"P0 and P1 must give .* got 700, 700, -0.5",
        ),
        ("sequences/07/times.txt", "0.1\nx\n", r"times.txt:2: must hold 1 finite numbers"),
        ("poses/07.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n", r"must have a pose for each of 5 stamps, got 1"),
        ("poses/07.txt", "9 0 0 0 0 1 0 0 0 0 1 0\n" * FRAMES, r"poses/07.txt:1: must be a rotation"),
    ],
)
def test_what_cannot_be_used_is_one_line(sequence, file, text, said):
    (sequence.parents[1] / file).write_text(text)
    with pytest.raises(DataError, match=said):
        open_images(sequence)


def test_sizes_by_the_head_of_a_file(rng):
    picture = rng.integers(0, 255, (37, 51)).astype(np.uint8)
    for suffix, more in ((".png", ()), (".jpg", ()), (".jpg", (cv2.IMWRITE_JPEG_PROGRESSIVE, 1))):
        content = cv2.imencode(suffix, picture, list(more))[1].tobytes()
        assert image_size(content) == (51, 37)
        for length in range(0, len(content), 7):
            assert image_size(content[:length]) in (None, (51, 37))
    assert image_size(b"BM" + struct.pack("<II", 3, 4)) is None
