"""Stereo images of a KITTI raw drive, synced (rectified) or "extract" (as the cameras gave them).

A drive ``DATE_drive_NNNN_sync`` or ``_extract`` has ``image_00`` to ``image_03``, each with
``timestamps.txt`` (a line an image) and ``data/NNNNNNNNNN.png``, and ``oxts``; the calibration files of its
day lie beside it (Geiger, Lenz, Stiller and Urtasun, *Vision meets robotics*, IJRR 2013, and the readme of
its development kit).
"""

from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.core.images import ImageRecording, Inertia, StampedPoses
from vislam.datasets.image_lists import NANOSECONDS, ImageFiles, Listed, paired
from vislam.datasets.inertial_table import possible
from vislam.datasets.kitti_calibration import matrix_of, numbered, read_calibration, rotation_of
from vislam.datasets.oxts import ACCELEROMETER, GYRO, read_oxts, read_timestamps
from vislam.datasets.oxts_poses import oxts_poses
from vislam.geometry import se3
from vislam.models.camera import Camera, Lens
from vislam.models.stereo import StereoRig
from vislam.models.stereo_pair import StereoPair

_PAIRS = (("00", "01"), ("02", "03"))
"""Grey pair, colour pair."""


def drive_in(folder: Path) -> Path | None:
    """The drive that a folder is, or that alone lies below it; None if there is none, or more than one."""
    if _cameras(folder) is not None:
        return folder
    found = [
        path for depth in ("*", "*/*") for path in sorted(folder.glob(depth)) if _cameras(path) is not None
    ]
    return found[0] if len(found) == 1 else None


def _cameras(drive: Path) -> tuple[str, str] | None:
    return next((pair for pair in _PAIRS if all((drive / f"image_{side}").is_dir() for side in pair)), None)


def load_kitti_raw(folder: Path) -> ImageRecording:
    """List a drive; no image is read.

    Raises
    ------
    DataError
        If images, stamps or calibration are missing or cannot be right, or no pair is left.
    """
    drive = drive_in(folder)
    if drive is None:
        raise DataError(
            f"{folder}: must be a KITTI raw drive with image_00 and image_01 (or image_02 and image_03)"
        )
    sides = _cameras(drive)
    assert sides is not None
    left, right, counts = paired(*(_listed(drive / f"image_{side}") for side in sides), where=drive)
    pair = _pair(drive, sides)
    stamp = np.asarray(left.stamp_ns * NANOSECONDS, dtype=np.float64)
    inertia, reference = None, None
    if (drive / "oxts").is_dir():
        inertia, reference, dropped = _oxts(drive / "oxts", stamp)
        counts = {**counts, **dropped}
    return ImageRecording(
        name=drive.name,
        stamp=stamp,
        left=left.images,
        right=right.images,
        pair=pair,
        inertia=inertia,
        reference=reference,
        levelled=inertia is not None,
        counts=counts,
    )


def _listed(folder: Path) -> Listed:
    """Stamps and files; the file of line k is the one of number k."""
    stamp = read_timestamps(folder / "timestamps.txt")
    return Listed(stamp, ImageFiles(numbered(folder / "data", len(stamp), digits=10)))


def _pair(drive: Path, sides: tuple[str, str]) -> StereoPair:
    """Cameras and rectified pair, by the calibration of the day."""
    path = drive.parent / "calib_cam_to_cam.txt"
    values = read_calibration(path)
    projections = [matrix_of(path, values, f"P_rect_{side}", (3, 4)) for side in sides]
    fx, fy, cx, cy = (float(projections[0][row]) for row in ((0, 0), (1, 1), (0, 2), (1, 2)))
    baseline = float(projections[0][0, 3] - projections[1][0, 3]) / fx if fx >= 1.0 else 0.0
    if baseline <= 0.0 or fy < 1.0:
        raise DataError(
            f"{path}: P_rect must give fx, fy >= 1 px and a baseline > 0 m, got {fx:g}, {fy:g}, {baseline:g}"
        )
    rect_R_grey = rotation_of(path, values, "R_rect_00")
    offset = np.asarray(np.linalg.solve(projections[0][:, :3], projections[0][:, 3]), dtype=np.float64)
    cam_T_imu = se3.from_rotation_translation(rect_R_grey, offset) @ _grey_T_imu(drive.parent)
    rig = StereoRig(fx, fy, cx, cy, baseline, se3.inverse(cam_T_imu))
    if not drive.name.endswith("_extract"):
        sizes = [_size(path, values, f"S_rect_{side}") for side in sides]
        plain = [Camera(*size, fx, fy, cx, cy) for size in sizes]
        return StereoPair(plain[0], plain[1], np.eye(3), np.eye(3), rig)
    cameras = [_camera(path, values, side) for side in sides]
    turns = [rotation_of(path, values, f"R_rect_{side}") for side in sides]
    return StereoPair(cameras[0], cameras[1], turns[0], turns[1], rig)


def _camera(path: Path, values: dict[str, list[float]], side: str) -> Camera:
    matrix = matrix_of(path, values, f"K_{side}", (3, 3))
    lens = matrix_of(path, values, f"D_{side}", (5,))
    fx, fy, cx, cy = (float(matrix[row]) for row in ((0, 0), (1, 1), (0, 2), (1, 2)))
    width, height = _size(path, values, f"S_{side}")
    return Camera(width, height, fx, fy, cx, cy, Lens.RADTAN, tuple(float(one) for one in lens))


def _size(path: Path, values: dict[str, list[float]], key: str) -> tuple[int, int]:
    width, height = matrix_of(path, values, key, (2,))
    return int(width), int(height)


def _grey_T_imu(day: Path) -> Array:
    """Pose of the inertial system in the left grey camera, ``(4, 4)``, by the laser scanner."""
    pose = np.eye(4)
    for name in ("calib_velo_to_cam.txt", "calib_imu_to_velo.txt"):
        values = read_calibration(day / name)
        rotation = rotation_of(day / name, values, "R")
        pose = pose @ se3.from_rotation_translation(rotation, matrix_of(day / name, values, "T", (3,)))
    return pose


def _oxts(folder: Path, stamp: Array) -> tuple[Inertia, StampedPoses, dict[str, int]]:
    """Inertial samples, and the poses of the same box at the stamps of the images."""
    stamp_ns, table = read_oxts(folder)
    _, first = np.unique(stamp_ns, return_index=True)
    at, table = np.asarray(stamp_ns[first] * NANOSECONDS, dtype=np.float64), table[first]
    counts = {
        "inertial_samples": len(at),
        "inertial_duplicates": len(stamp_ns) - len(at),
        "inertial_out_of_order": int(np.sum(np.diff(stamp_ns) < 0)),
    }
    gyro, accelerometer = possible(table[:, GYRO], table[:, ACCELEROMETER], where=folder)
    inertia = Inertia(at, gyro, velocity=table[:, 8:11], accelerometer=accelerometer)
    return inertia, oxts_poses(at, table, stamp), counts
