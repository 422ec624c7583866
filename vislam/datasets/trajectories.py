"""Readers of reference trajectories, one a file format: read, checked, matched with the frames."""

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.base.errors import DataError
from vislam.base.types import Array, IntArray
from vislam.core.reference import Reference
from vislam.datasets.settings import STAMPED, ReferenceConfig
from vislam.datasets.text import read_table
from vislam.geometry import se3, so3
from vislam.models import CAMERA_AXES

_log = logging.getLogger("vislam.datasets")

UPRIGHT = se3.from_rotation_translation(CAMERA_AXES, np.zeros(3))
"""From camera axes to x forward, y left, z up: planar and height then mean the same for all."""
_ROTATION_TOLERANCE = 1e-3
"""How far R^T R may be from the identity; the files carry seven digits."""
_NORM_TOLERANCE = 1e-2
"""How far the norm of a quaternion may be from 1; some files carry four digits."""
_FARTHEST = 1e9
"""A position farther from the origin [m], or a frame or a stamp [s] beyond ten times that, is none."""
_FEWEST = 2


@dataclass(frozen=True)
class _Rows:
    """What a file holds: the frame or the stamp of each row, and its position or its pose."""

    path: Path
    line: IntArray
    at: Array
    position: Array
    pose: Array | None

    def fail(self, row: int, expected: str, got: str) -> DataError:
        return DataError(f"{self.path}:{self.line[row]}: must have {expected}, got {got}")


def load_reference(path: Path, config: ReferenceConfig, *, imu_T_cam: Array, stamp: Array) -> Reference:
    """Read a reference file in one of the formats of :class:`ReferenceConfig`.

    A row belongs to the frame that it names (``planar_xy``, ``kitti360``), to the frame of its place in the
    file (``kitti``), or to the frame of the nearest camera stamp (``tum``, ``euroc``), each frame having the
    nearest row at most.

    Parameters
    ----------
    path : Path
    config : ReferenceConfig
    imu_T_cam : (4, 4)
        Where the left camera sits in the body, for a reference that states its poses.
    stamp : (T,)
        Camera times of the recording [s]; rows that belong to none of its frames are dropped and logged.

    Raises
    ------
    DataError
        If the file cannot be read, a value in it cannot be right (ragged lines, NaN, a matrix that is no
        rotation, frames or stamps that do not increase), or it covers fewer than two frames.
    """
    rows = _READERS[config.format](path)
    if len(rows.at) < _FEWEST:
        raise DataError(f"{path}: must have {_FEWEST} lines of {config.format} or more, got {len(rows.at)}")
    _check(rows)
    if config.format in STAMPED:
        row, frame = _by_stamp(rows.at, stamp, config.max_time_difference)
        remedy = "are its stamps in the clock of the recording?"
    else:
        _check_frames(rows)
        row = np.flatnonzero(rows.at < len(stamp))
        frame = rows.at[row].astype(np.int64)
        remedy = "does it belong to this recording?"
    _log.info("%s: %d rows, %d belong to no frame", path.name, len(rows.at), len(rows.at) - len(row))
    if len(row) < _FEWEST:
        raise DataError(
            f"{path}: must cover {_FEWEST} of the {len(stamp)} frames or more, got {len(row)}; {remedy}"
        )
    turn = UPRIGHT if config.up == "-y" else np.eye(4)
    pose = None if rows.pose is None else turn @ rows.pose[row]
    return Reference(
        name=config.name,
        limits=config.limits,
        frame=frame,
        position=rows.position[row] if pose is None else pose[:, :3, 3],
        pose=pose,
        imu_T_point=imu_T_cam if config.pose_of == "left_camera" else np.eye(4),
        sigma=config.sigma_m,
    )


def read_poses(path: Path, format: Literal["kitti", "tum"]) -> tuple[Array, Array]:
    """Read the poses of a file without matching them with anything.

    Returns
    -------
    at : (n,)
        Place in the file, from 0 (``kitti``), or stamp [s] (``tum``).
    pose : (n, 4, 4)

    Raises
    ------
    DataError
        As :func:`load_reference`, but for what concerns frames.
    """
    rows = _READERS[format](path)
    _check(rows)
    assert rows.pose is not None
    return rows.at, rows.pose


def _planar_xy(path: Path) -> _Rows:
    table, line = read_table(path, columns=3)
    return _Rows(path, line, table[:, 0], table[:, 1:], None)


def _kitti(path: Path) -> _Rows:
    table, line = read_table(path, columns=12)
    return _of_matrices(path, line, np.arange(float(len(table))), table)


def _kitti360(path: Path) -> _Rows:
    table, line = read_table(path, columns=13)
    return _of_matrices(path, line, table[:, 0], table[:, 1:])


def _tum(path: Path) -> _Rows:
    table, line = read_table(path, columns=8)
    return _of_quaternions(path, line, table)


def _euroc(path: Path) -> _Rows:
    table, line = read_table(path, columns=8, more=True, comma=True)
    # Stamps are in ns, quaternions scalar first.
    table = table[:, [0, 1, 2, 3, 5, 6, 7, 4]] * np.array([1e-9, *[1.0] * 7])
    return _of_quaternions(path, line, table)


_READERS = {"planar_xy": _planar_xy, "kitti": _kitti, "kitti360": _kitti360, "tum": _tum, "euroc": _euroc}


def _of_matrices(path: Path, line: IntArray, at: Array, numbers: Array) -> _Rows:
    matrix = numbers.reshape(-1, 3, 4)
    pose = se3.from_rotation_translation(matrix[:, :, :3], matrix[:, :, 3])
    return _Rows(path, line, at, pose[:, :3, 3], pose)


def _of_quaternions(path: Path, line: IntArray, table: Array) -> _Rows:
    """Rows of stamp [s], position [m] and quaternion x y z w."""
    norm = np.linalg.norm(table[:, 4:], axis=1)
    wrong = np.flatnonzero(~(np.abs(norm - 1.0) < _NORM_TOLERANCE))
    if len(wrong):
        raise DataError(
            f"{path}:{line[wrong[0]]}: must have a quaternion of norm 1, got norm {norm[wrong[0]]:.3g}; "
            "is the format the right one?"
        )
    rotation = Rotation.from_quat(table[:, 4:]).as_matrix() if len(table) else np.empty((0, 3, 3))
    return _Rows(
        path, line, table[:, 0], table[:, 1:4], se3.from_rotation_translation(rotation, table[:, 1:4])
    )


def _check(rows: _Rows) -> None:
    """Raise DataError at the first row that cannot be right."""
    far = np.flatnonzero(np.abs(rows.position).max(axis=1) > _FARTHEST)
    if len(far):
        raise rows.fail(far[0], f"a position within {_FARTHEST:g} m", f"{rows.position[far[0]].tolist()}")
    beyond = np.flatnonzero(~((rows.at >= 0) & (rows.at <= 10 * _FARTHEST)))
    if len(beyond):
        raise rows.fail(beyond[0], "a frame or a stamp from 0 on", f"{rows.at[beyond[0]]:g}")
    falling = np.flatnonzero(np.diff(rows.at) <= 0)
    if len(falling):
        first = falling[0]
        raise rows.fail(
            first + 1,
            "frames or stamps that increase",
            f"{rows.at[first + 1]:.6f} after {rows.at[first]:.6f}",
        )
    if rows.pose is None:
        return
    off, determinant = so3.defect(rows.pose[:, :3, :3])
    improper = np.flatnonzero(~(off < _ROTATION_TOLERANCE) | (determinant < 0))
    if len(improper):
        first = improper[0]
        raise rows.fail(
            first,
            "a rotation (orthogonal, determinant +1)",
            f"R^T R off by {off[first]:.2g}, determinant {determinant[first]:.3g}",
        )


def _check_frames(rows: _Rows) -> None:
    """Raise DataError at the first frame that is no whole number."""
    broken = np.flatnonzero(rows.at != np.round(rows.at))
    if len(broken):
        raise rows.fail(broken[0], "a whole number for its frame", f"{rows.at[broken[0]]:g}")


def _by_stamp(at: Array, stamp: Array, tolerance: float) -> tuple[IntArray, IntArray]:
    """Rows and frames that belong together: nearest in time, within the tolerance [s], one row a frame."""
    after = np.clip(np.searchsorted(stamp, at), 1, len(stamp) - 1)
    frame = np.where(at - stamp[after - 1] <= stamp[after] - at, after - 1, after)
    apart = np.abs(at - stamp[frame])
    order = np.lexsort((apart, frame))
    order = order[apart[order] <= tolerance]
    _, first = np.unique(frame[order], return_index=True)
    row = order[first]
    return row, frame[row]
