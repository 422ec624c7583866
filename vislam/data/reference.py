"""Reference trajectories: what a run is scored against, by name and with its limits."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from vislam.errors import DataError
from vislam.geometry import se3
from vislam.types import Array, IntArray

_UPRIGHT = se3.from_rotation_translation(
    np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3)
)
"""From camera axes to x forward, y left, z up: planar and height then mean the same for all."""


@dataclass(frozen=True)
class Reference:
    """Poses or positions to compare with.

    Attributes
    ----------
    name, limits : str
        For the report. "Truth" is the name of a simulation's alone.
    frame : (m,)
        Frames it covers.
    position : (m, 2) or (m, 3)
        Positions of the point below [m]; two columns if it is planar.
    pose : (m, 4, 4) or None
        Full poses of that point's frame.
    imu_T_point : (4, 4)
        Where the reference point sits in the body.
    track, points_world : (j,), (j, 3)
        True landmarks of a simulation [m]; empty elsewhere.
    """

    name: str
    limits: str
    frame: IntArray
    position: Array
    pose: Array | None
    imu_T_point: Array
    track: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    points_world: Array = field(default_factory=lambda: np.empty((0, 3)))

    @property
    def planar(self) -> bool:
        """Whether it has no height."""
        return self.position.shape[1] == 2


def load_reference(
    path: Path,
    form: Literal["planar_xy", "kitti_cam"],
    *,
    name: str,
    limits: str,
    imu_T_cam: Array,
    frames: int,
) -> Reference:
    """Read a reference file.

    Parameters
    ----------
    path : Path
    form : str
        ``planar_xy``: frame, x, y of the body. ``kitti_cam``: one left camera pose a line, 12 numbers.
    name, limits : str
    imu_T_cam : (4, 4)
    frames : int
        Frames of the recording; what lies beyond is dropped.

    Raises
    ------
    DataError
        If the file cannot be read or has the wrong number of columns.
    """
    columns = 3 if form == "planar_xy" else 12
    try:
        table = np.loadtxt(path, ndmin=2)
    except OSError as error:
        raise DataError(f"{path}: reference cannot be read ({error.strerror or error})") from None
    except ValueError as error:
        raise DataError(f"{path}: reference must hold numbers only, {error}") from None
    if table.shape[1] != columns or len(table) < 2 or not np.all(np.isfinite(table)):
        raise DataError(
            f"{path}: reference must have {columns} finite numbers a line and two lines, got {table.shape}"
        )
    if form == "planar_xy":
        inside = (table[:, 0] >= 0) & (table[:, 0] < frames)
        frame = table[inside, 0].astype(np.int64)
        return Reference(name, limits, frame, table[inside, 1:], None, np.eye(4))
    rows = table[:frames].reshape(-1, 3, 4)
    pose = _UPRIGHT @ se3.from_rotation_translation(rows[:, :, :3], rows[:, :, 3])
    return Reference(name, limits, np.arange(len(pose)), pose[:, :3, 3], pose, imu_T_cam)


def truth_reference(world_T_imu: Array, track: IntArray, points_world: Array) -> Reference:
    """Reference of a simulation: its exact truth.

    Parameters
    ----------
    world_T_imu : (T, 4, 4)
    track, points_world : (j,), (j, 3)
        True landmarks [m].
    """
    return Reference(
        name="truth",
        limits="exact, simulated",
        frame=np.arange(len(world_T_imu)),
        position=world_T_imu[:, :3, 3],
        pose=world_T_imu,
        imu_T_point=np.eye(4),
        track=track,
        points_world=points_world,
    )
