"""Stereo images of a KITTI odometry sequence, rectified, with its poses where they lie beside.

A sequence ``sequences/NN`` has ``image_0`` and ``image_1`` (grey) or ``image_2`` and ``image_3`` (colour)
with ``NNNNNN.png``, ``calib.txt`` (projections ``P0`` to ``P3``) and ``times.txt`` [s]; the poses of camera 0
are in ``poses/NN.txt`` (Geiger, Lenz and Urtasun, *Are we ready for autonomous driving?*, CVPR 2012).
"""

from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array, IntArray
from vislam.core.images import ImageRecording, StampedPoses
from vislam.datasets.image_lists import NANOSECONDS, ImageFiles, Listed, paired
from vislam.datasets.image_size import image_size
from vislam.datasets.kitti_calibration import matrix_of, numbered, read_calibration
from vislam.datasets.text import read_table
from vislam.geometry import se3
from vislam.models import CAMERA_AXES
from vislam.models.camera import Camera
from vislam.models.stereo import StereoRig
from vislam.models.stereo_pair import StereoPair

_PAIRS = (("0", "1"), ("2", "3"))
"""Grey pair, colour pair."""
_TOLERANCE = 1e-3


def is_kitti_odometry(folder: Path) -> bool:
    """Whether a folder is a sequence of this layout."""
    return (folder / "calib.txt").is_file() and _sides(folder) is not None


def _sides(folder: Path) -> tuple[str, str] | None:
    return next((pair for pair in _PAIRS if all((folder / f"image_{side}").is_dir() for side in pair)), None)


def load_kitti_odometry(folder: Path) -> ImageRecording:
    """List a sequence; no image is decoded.

    The body is at the left camera, x forward and z up.

    Raises
    ------
    DataError
        If images, stamps or calibration are missing or cannot be right, or no pair is left.
    """
    sides = _sides(folder)
    assert sides is not None
    stamp_ns = _stamps(folder / "times.txt")
    listed = [
        Listed(stamp_ns, ImageFiles(numbered(folder / f"image_{side}", len(stamp_ns), digits=6)))
        for side in sides
    ]
    left, right, counts = paired(listed[0], listed[1], where=folder)
    pair, cam_T_cam0 = _pair(folder / "calib.txt", sides, _size(left))
    name = folder.absolute().name
    return ImageRecording(
        name=f"kitti_odometry_{name}" if name.isdigit() else name,
        stamp=np.asarray(left.stamp_ns * NANOSECONDS, dtype=np.float64),
        left=left.images,
        right=right.images,
        pair=pair,
        reference=_reference(folder, stamp_ns, pair.rig.imu_T_cam @ cam_T_cam0),
        counts=counts,
    )


def _stamps(path: Path) -> IntArray:
    table, _ = read_table(path, columns=1, more=True)
    return np.rint(table[:, 0] / NANOSECONDS).astype(np.int64)


def _size(listed: Listed) -> tuple[int, int]:
    """Width and height of the first image that has a head."""
    for content in listed.images:
        if isinstance(content, bytes) and (size := image_size(content)) is not None:
            return size
    raise DataError(f"{listed.images.place}: must have PNG or JPEG images, got none that can be read")


def _pair(path: Path, sides: tuple[str, str], size: tuple[int, int]) -> tuple[StereoPair, Array]:
    """The rectified pair, and the pose of camera 0 in the left one, ``(4, 4)``."""
    values = read_calibration(path)
    left, right = (matrix_of(path, values, f"P{side}", (3, 4)) for side in sides)
    fx, fy, cx, cy = (float(left[row]) for row in ((0, 0), (1, 1), (0, 2), (1, 2)))
    baseline = float(left[0, 3] - right[0, 3]) / fx if fx >= 1.0 else 0.0
    if baseline <= 0.0 or fy < 1.0:
        raise DataError(
            f"{path}: P{sides[0]} and P{sides[1]} must give fx, fy >= 1 px and a baseline > 0 m, got "
            f"{fx:g}, {fy:g}, {baseline:g}"
        )
    offset: Array = np.asarray(np.linalg.solve(left[:, :3], left[:, 3]), dtype=np.float64)
    cam_T_cam0 = se3.from_rotation_translation(np.eye(3), offset)
    imu_T_cam = se3.from_rotation_translation(CAMERA_AXES, np.zeros(3))
    camera = Camera(*size, fx, fy, cx, cy)
    rig = StereoRig(fx, fy, cx, cy, baseline, imu_T_cam)
    return StereoPair(camera, camera, np.eye(3), np.eye(3), rig), cam_T_cam0


def _reference(folder: Path, stamp_ns: IntArray, imu_T_cam0: Array) -> StampedPoses | None:
    """Poses of the body in a world whose axes are the first camera's, turned so that z is up."""
    places = (folder / "poses.txt", folder.absolute().parents[1] / "poses" / f"{folder.absolute().name}.txt")
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        return None
    table, line = read_table(path, columns=12)
    if len(table) != len(stamp_ns):
        raise DataError(f"{path}: must have a pose for each of {len(stamp_ns)} stamps, got {len(table)}")
    pose = np.tile(np.eye(4), (len(table), 1, 1))
    pose[:, :3] = table.reshape(-1, 3, 4)
    rigid = se3.is_rigid(pose, tolerance=_TOLERANCE)
    if not rigid.all():
        raise DataError(f"{path}:{line[np.argmin(rigid)]}: must be a rotation and a position by rows (3 x 4)")
    stamp, first = np.unique(stamp_ns, return_index=True)
    return StampedPoses(
        stamp=np.asarray(stamp * NANOSECONDS, dtype=np.float64),
        world_T_imu=imu_T_cam0 @ pose[first] @ se3.inverse(imu_T_cam0),
        origin="GNSS/INS, projected into the left camera by KITTI",
        name="KITTI odometry poses",
    )
