"""Trajectory files as references of a recording, and as trajectories on their own stamps."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.base.errors import DataError
from vislam.base.types import Array, IntArray
from vislam.core.reference import Reference
from vislam.core.stamped import Stamped, nearest
from vislam.datasets.settings import ReferenceConfig, TrajectoryConfig
from vislam.datasets.trajectory_formats import ReadOptions, Rows, read_rows
from vislam.datasets.trajectory_formats.quaternions import sidecar
from vislam.datasets.trajectory_formats.stamps import seconds
from vislam.datasets.trajectory_formats.table import read_text_table
from vislam.geometry import se3
from vislam.geometry.pose_covariance import CovarianceConvention
from vislam.models import CAMERA_AXES

_log = logging.getLogger("vislam.datasets")

UPRIGHT = se3.from_rotation_translation(CAMERA_AXES, np.zeros(3))
"""From camera axes to x forward, y left, z up: planar and height then mean the same for all."""
_FEWEST = 2
_MARGIN = 10.0
"""Time before and after the recording from which rows are kept for trajectories from elsewhere [s]."""
_SAME_STAMP = 1e-4
"""How far the stamp of a covariance may be from that of its pose [s]."""


def load_reference(path: Path, config: ReferenceConfig, *, imu_T_cam: Array, stamp: Array) -> Reference:
    """Read a reference file in one of the formats of :class:`ReferenceConfig`.

    A row belongs to the frame that it names (``planar_xy``, ``kitti360``), to the frame of its place in the
    file (``kitti``), or to the frame of the nearest camera stamp, each frame having the nearest row at most;
    with ``association: interpolate`` a frame has what lies between the rows around it.

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
        If the file cannot be read, a value in it cannot be right (ragged lines, a matrix that is no
        rotation), or it covers fewer than two frames; if ``strict``, also at what would be mended.
    """
    rows = read_rows(path, config.format, ReadOptions(strict=config.strict))
    if len(rows) < _FEWEST:
        raise DataError(f"{path}: must have {_FEWEST} lines of {config.format} or more, got {len(rows)}")
    if rows.counts:
        _log.info("%s: %s", path.name, ", ".join(f"{key} {value}" for key, value in rows.counts.items()))
    own = _upright(_stamped(rows), config.up)
    source = None
    if rows.stamp is not None:
        frame, own, source = _at_frames(own, stamp, config)
        remedy = "are its stamps in the clock of the recording?"
    else:
        assert rows.frame is not None
        row = np.flatnonzero(rows.frame < len(stamp))
        frame, own = rows.frame[row], own.take(row)
        remedy = "does it belong to this recording?"
    _log.info("%s: %d rows, %d belong to no frame", path.name, len(rows), len(rows) - len(frame))
    if len(frame) < _FEWEST:
        raise DataError(
            f"{path}: must cover {_FEWEST} of the {len(stamp)} frames or more, got {len(frame)}; {remedy}"
        )
    return Reference(
        name=config.name,
        limits=config.limits,
        frame=frame,
        position=own.position,
        pose=own.pose,
        imu_T_point=imu_T_cam if config.pose_of == "left_camera" else np.eye(4),
        sigma=config.sigma_m,
        sigma_rotation=float(np.deg2rad(config.sigma_deg)),
        source=source,
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
    rows = read_rows(path, format)
    assert rows.pose is not None
    return rows.at, rows.pose


@dataclass(frozen=True)
class Given:
    """A trajectory of another program, interpreted by its options.

    Attributes
    ----------
    config : TrajectoryConfig
    stamped : Stamped
        Its covariances are as the file has them.
    convention : CovarianceConvention or None
        Of the covariances, as far as options or format say it.
    by_place : bool
        Whether its frames are the places in the file and nothing else.
    told : tuple of str
    counts : dict
    """

    config: TrajectoryConfig
    stamped: Stamped
    convention: CovarianceConvention | None
    by_place: bool
    told: tuple[str, ...]
    counts: dict[str, int]


def load_trajectory(config: TrajectoryConfig) -> Given:
    """Read a trajectory file on its own stamps, with all that its options ask for but an estimated clock.

    Raises
    ------
    DataError
        If it cannot be read, has fewer than two rows, or a file beside it does not fit.
    """
    path = Path(config.file)
    rows = read_rows(path, config.format, config.options)
    if len(rows) < _FEWEST:
        raise DataError(f"{path}: must have {_FEWEST} rows or more, got {len(rows)}")
    rows = _with_places(rows, config)
    rows = _with_sidecar(rows, config)
    own = _turned_round(_stamped(rows), config)
    own = _upright(own, config.up)
    if isinstance(config.clock_offset, float | int) and config.clock_offset:
        own = own.shifted(float(config.clock_offset))
    return Given(
        config=config,
        stamped=_at_point(own, config),
        convention=_convention(rows, config),
        by_place=rows.by_place,
        told=rows.told,
        counts=rows.counts,
    )


def _stamped(rows: Rows) -> Stamped:
    position = rows.position if rows.pose is None else rows.pose[:, :3, 3]
    return Stamped(rows.at, position, rows.pose, rows.cov, timed=rows.stamp is not None)


def _upright(own: Stamped, up: str) -> Stamped:
    if up == "z":
        return own
    if own.pose is None:
        return replace(own, position=own.position @ CAMERA_AXES.T)
    pose = UPRIGHT @ own.pose
    return replace(own, position=pose[:, :3, 3], pose=pose)


def _at_frames(own: Stamped, stamp: Array, config: ReferenceConfig) -> tuple[IntArray, Stamped, Stamped]:
    """Frames that have a row, the rows, and all rows around the recording on their own stamps."""
    near = (own.stamp >= stamp[0] - _MARGIN) & (own.stamp <= stamp[-1] + _MARGIN)
    source = own.take(near)
    if config.association == "interpolate" and len(source) > 1:
        frame = np.flatnonzero(source.within(stamp))
        return frame, source.interpolated(stamp[frame]), source
    row, frame = nearest(own.stamp, stamp, config.max_time_difference)
    return frame, own.take(row), source


def _with_places(rows: Rows, config: TrajectoryConfig) -> Rows:
    """Rows with the stamps, or the frames, of a file beside them."""
    name = config.times or config.frames
    if name is None:
        return rows
    column = read_text_table(Path(name)).values
    if rows.frame is None:
        raise DataError(f"{rows.path}: has stamps of its own; times and frames are for a file that has none")
    if column.shape[1:] != (1,) and not (column.ndim == 2 and column.shape[1] >= 1):
        raise DataError(f"{name}: must hold a number a line, got none")
    if len(column) <= rows.frame[-1]:
        raise DataError(
            f"{name}: must have a line for each of the {rows.frame[-1] + 1} rows of {rows.path.name}, "
            f"got {len(column)}"
        )
    values = column[rows.frame, 0]
    if not np.isfinite(values).all() or (np.diff(values) <= 0).any():
        raise DataError(f"{name}: must hold numbers that increase; sort them, or drop the rows without one")
    if config.frames is not None:
        if (values != np.round(values)).any():
            raise DataError(f"{name}: must hold whole numbers of frames")
        return replace(rows, frame=values.astype(np.int64), by_place=False)
    stamp, told = seconds(values, config.unit)
    return replace(rows, stamp=stamp, frame=None, by_place=False, told=(*rows.told, *told))


def _with_sidecar(rows: Rows, config: TrajectoryConfig) -> Rows:
    """Rows with the covariances of a file beside them, matched one to one by stamp."""
    if config.cov is None:
        return rows
    if rows.stamp is None:
        raise DataError(f"{rows.path}: has no stamps, by which covariances of {config.cov} could be matched")
    raw, cov, convention = sidecar(read_text_table(Path(config.cov)))
    stamp, _ = seconds(raw, config.unit)
    order = np.argsort(stamp, kind="stable")
    own, other = nearest(rows.stamp, stamp[order], _SAME_STAMP)
    if len(own) < len(rows):
        lacking = np.setdiff1d(np.arange(len(rows)), own)[0]
        raise DataError(
            f"{config.cov}: must have a covariance for each of the {len(rows)} poses of {rows.path.name}, "
            f"got none at {rows.stamp[lacking]:.6f}"
        )
    return replace(rows, cov=cov[order][other], convention=convention)


def _convention(rows: Rows, config: TrajectoryConfig) -> CovarianceConvention | None:
    """Convention of the covariances; None where neither the options nor the format say it."""
    if rows.cov is None:
        return None
    order, frame = config.cov_order, config.cov_frame
    if rows.convention is not None:
        order = rows.convention.order if order == "auto" else order
        frame = rows.convention.frame if frame == "auto" else frame
    return None if order == "auto" or frame == "auto" else CovarianceConvention(order, frame)


def _turned_round(own: Stamped, config: TrajectoryConfig) -> Stamped:
    if own.pose is None or not (config.conjugated or config.inverted):
        return own
    if config.inverted:
        pose = se3.inverse(own.pose)
        return replace(own, pose=pose, position=pose[:, :3, 3])
    turn = own.pose[:, :3, :3].transpose(0, 2, 1)
    return replace(own, pose=se3.from_rotation_translation(turn, own.position))


def _at_point(own: Stamped, config: TrajectoryConfig) -> Stamped:
    """Poses of the point that the others are about."""
    if config.body_T_point is None:
        return own
    if own.pose is None:
        raise DataError(f"{config.file}: has no attitudes, by which body_T_point could be turned")
    quaternion = np.array(config.body_T_point[3:])
    if abs(np.linalg.norm(quaternion) - 1.0) > 1e-2:
        raise DataError(f"{config.file}: body_T_point must end in a quaternion of norm 1")
    turn = Rotation.from_quat(quaternion).as_matrix()
    pose = own.pose @ se3.from_rotation_translation(turn, np.array(config.body_T_point[:3]))
    return replace(own, pose=pose, position=pose[:, :3, 3])
