"""Raw inertia of the drive whose stereo tracks come with GTSAM: found on its clock, and what it tells of up.

GTSAM's GPS example brings 470 s of accelerometer and gyro at 100 Hz, of the drive that KITTI odometry 00 is
of (2011_10_03_drive_0027), on a clock that the tracks do not know. Between its first two samples is a gap of
1.9 s, so that it begins 1.4 s after the first frame.
"""

from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.core.imu import ImuSeries
from vislam.core.integrals import Integral
from vislam.datasets.gyro_alignment import GyroAlignment, align_gyro
from vislam.geometry import se3, so3

FILE = "KittiEquivBiasedImu.txt"
IMU_T_CAM = se3.inverse(
    np.array(
        [
            [0.001197, -0.999977, 0.006738, 0.0],
            [-0.009241, -0.006749, -0.999935, 0.0],
            [0.999956, 0.001134, -0.009249, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )
)
"""Rotation of the rectified left camera in the inertial sensor's axes, by the calibration of the day
(``calib_imu_to_velo``, ``calib_velo_to_cam``, ``R_rect_00`` of KITTI raw 2011_10_03)."""
IMU_T_CAM[:3, 3] = (1.1022, -0.3191, 0.7461)
"""And its place there [m]."""
_COLUMNS = 8
_CLEAR = 0.5
"""Residuals at the offset that is found must be smaller than at any other by this factor."""


def read_inertia(path: Path) -> ImuSeries:
    """Samples of the file, whose first line names the columns.

    Raises
    ------
    DataError
        If it cannot be read or is no such table.
    """
    table = _table(path)
    try:
        return ImuSeries.of(table[:, 0], table[:, 5:8], table[:, 2:5])
    except ValueError as why:
        raise DataError(f"{path}: {why}") from None


def _table(path: Path) -> Array:
    try:
        table = np.loadtxt(path, skiprows=1, ndmin=2)
    except (OSError, ValueError) as why:
        raise DataError(
            f"{path}: must be a table of {_COLUMNS} numbers a line below its names: {why}"
        ) from None
    if table.shape[1] != _COLUMNS or not np.isfinite(table).all():
        raise DataError(
            f"{path}: must have {_COLUMNS} finite numbers a line (Time, dt, accel, omega), got "
            f"{table.shape[1]} columns"
        )
    return table


def find_drive(stamp: Array, world_T_imu: Array, series: ImuSeries, *, where: str) -> GyroAlignment:
    """Place of a drive on the clock of the samples.

    Parameters
    ----------
    stamp : (T,)
        Camera times [s].
    world_T_imu : (T, 4, 4)
        Poses by the tracks alone.
    series : ImuSeries
    where : str
        What the samples are of, for an error.

    Raises
    ------
    DataError
        If at no offset the gyro follows the tracks clearly better than at all others.
    """
    turn = world_T_imu[:, :3, :3]
    found = align_gyro(stamp, so3.log(turn[:-1].transpose(0, 2, 1) @ turn[1:]), series)
    if found is None or not found.residual < _CLEAR * found.elsewhere:
        told = "the samples are too short" if found is None else _compared(found)
        raise DataError(
            f"{where}: must have the rates of the stereo tracks at one offset of its clock, got none that "
            f"stands out ({told}); use the tracks without it, imu: false"
        )
    return found


def _compared(found: GyroAlignment) -> str:
    return (
        f"residual {found.residual:.4f} rad/s at {found.offset:.2f} s, {found.elsewhere:.4f} rad/s at the "
        f"best of {found.tried} others"
    )


def describe(found: GyroAlignment, first: float) -> str:
    """How the offset was found, and how sure it is, for the notes of a run.

    Parameters
    ----------
    found : GyroAlignment
    first : float
        Stamp of the first sample [s].
    """
    correlation = ", ".join(f"{value:.3f}" for value in found.correlation)
    return (
        f"frame 0 of the tracks is {found.offset - first:.3f} s after the first sample, 95 % interval "
        f"+-{1.96 * found.sigma:.3f} s, where the gyro follows the turns of the tracks ({found.steps} steps, "
        f"correlation about x, y, z {correlation}, residual {found.residual:.4f} rad/s; the best of "
        f"{found.tried} offsets elsewhere leaves {found.elsewhere:.4f} rad/s)"
    )


def covered_from(stamp: Array, series: ImuSeries) -> int:
    """First frame from which on samples cover all, behind the last gap of the series within the drive."""
    after = series.stamp[1:][series.gaps & (series.stamp[1:] < stamp[-1])]
    return int(np.searchsorted(stamp, after.max(initial=series.stamp[0])))


def level(stamp: Array, world_T_imu: Array, series: ImuSeries) -> Array:
    """Rotation ``(3, 3)`` that takes the world of poses to one whose z axis points up.

    The mean specific force over a drive, in the axes of the world, is its mean acceleration, which the poses
    tell from the velocities at both ends, less gravity. An accelerometer bias of 0.05 m/s^2 tilts it by 0.3
    degrees.

    Parameters
    ----------
    stamp : (T,)
        Camera times on the clock of the samples, four or more [s].
    world_T_imu : (T, 4, 4)
    series : ImuSeries
        Covers them.
    """
    turn, place = world_T_imu[:, :3, :3], world_T_imu[:, :3, 3]
    force = np.diff(Integral(series.stamp, series.accel).once(stamp), axis=0)[1:-1]
    half = so3.exp(0.5 * so3.log(turn[1:-2].transpose(0, 2, 1) @ turn[2:-1]))
    gained = np.einsum("kij,kj->i", turn[1:-2] @ half, force)
    velocity = (place[[2, -1]] - place[[0, -3]]) / (stamp[[2, -1]] - stamp[[0, -3]])[:, None]
    up = gained - (velocity[1] - velocity[0])
    return np.asarray(so3.onto(up / np.linalg.norm(up), np.array([0.0, 0.0, 1.0])))
