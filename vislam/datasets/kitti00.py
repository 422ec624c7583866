"""Real stereo tracks that come with GTSAM: the first 16 s of KITTI odometry 00, as of its VO example.

They have no odometry. The twist of each step is made from the poses of a visual odometry that the example
brings, with white noise added. The tracks, the camera and the noise of the tracks are real. Another example
brings raw inertia of the same drive (:mod:`vislam.datasets.kitti00_inertia`).
"""

import hashlib
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.core.reference import Reference
from vislam.core.sequence import Sequence, piecewise_constant
from vislam.datasets.kitti00_batch import batch_poses
from vislam.datasets.kitti00_inertia import (
    FILE,
    IMU_T_CAM,
    covered_from,
    describe,
    find_drive,
    level,
    read_inertia,
)
from vislam.datasets.recording import Opening, Recording
from vislam.datasets.settings import Kitti00
from vislam.datasets.text import read_table
from vislam.geometry import se3
from vislam.models import CAMERA_AXES, StereoRig

_PERIOD = 0.1037
"""Mean camera period of KITTI odometry 00 [s]; the files number the frames and have no stamps."""
_NAME = "KITTI 00 tracks with made odometry"
_INERTIAL = "KITTI 00 tracks with raw inertia"
_CAMERA = se3.from_rotation_translation(CAMERA_AXES, np.zeros(3))
"""Where the camera is in a body that sits in it, x forward, y left, z up."""


def read(source: Kitti00, opening: Opening) -> Recording:
    """Read the tracks, and make the odometry with the noise that is asked for."""
    sequence, reference = load_kitti00(
        gyro_sigma=source.gyro_sigma,
        velocity_sigma=source.velocity_sigma,
        seed=opening.seed,
        imu_T_cam=IMU_T_CAM if source.imu else _CAMERA,
    )
    made = (
        f"the twist is that of their visual odometry with noise added, {source.gyro_sigma:g} rad/s and "
        f"{source.velocity_sigma:g} m/s"
    )
    if source.imu:
        sequence, reference, found = with_inertia(sequence, reference)
        note = (
            "the stereo tracks are real, KITTI odometry 00, and so are accelerometer and gyro of the same "
            f"drive, {FILE}: {found}. MADE ODOMETRY: {made}; motion: imu makes no use of it"
        )
    else:
        note = (
            "MADE ODOMETRY: the stereo tracks are real, KITTI odometry 00; they are read without inertial "
            f"data, so {made}"
        )
    return Recording(
        sequence, reference, notes=(f"{note}. The reference is the {reference.name}, {reference.limits}",)
    )


def load_kitti00(
    *, gyro_sigma: float, velocity_sigma: float, seed: int, imu_T_cam: Array = _CAMERA
) -> tuple[Sequence, Reference]:
    """Read the tracks, make the odometry, and solve for the reference, which takes seconds.

    There are 135 frames with numbers from 0 to 153; 19 were left out by those who made the files.

    Parameters
    ----------
    gyro_sigma, velocity_sigma : float
        White noise of the twist over a camera period [rad/s, m/s]; a step of two periods has less of it.
    seed : int
        Seed of that noise.
    imu_T_cam : (4, 4)
        Where the left camera is in the body; by default the body sits in it, x forward, y left, z up.

    Returns
    -------
    Sequence
    Reference
        Batch solution of all the tracks without any odometry. It is no independent truth.

    Raises
    ------
    DataError
        If the installed GTSAM does not bring the files.
    """
    number, world_T_imu = _visual_odometry(imu_T_cam)
    sigma = np.repeat([gyro_sigma, velocity_sigma], 3)
    sequence = _sequence(number, world_T_imu, sigma, seed=seed, imu_T_cam=imu_T_cam)
    return sequence, _reference(
        batch_poses(sequence, world_T_imu), limits="not independent of the estimates: same tracks"
    )


def with_inertia(sequence: Sequence, reference: Reference) -> tuple[Sequence, Reference, str]:
    """Frames that accelerometer and gyro cover, with their samples, the reference levelled, and an account.

    Parameters
    ----------
    sequence : Sequence
        All frames, the body being the inertial sensor.
    reference : Reference
        With the poses of all frames, by the tracks alone.

    Raises
    ------
    DataError
        If the file is missing, or is of another drive.
    """
    assert reference.pose is not None
    path = _file(FILE)
    series = read_inertia(path)
    found = find_drive(sequence.stamp, reference.pose, series, where=str(path))
    account = describe(found, float(series.stamp[0]))
    series = replace(series, stamp=series.stamp - found.offset)
    first = covered_from(sequence.stamp, series)
    part, pose = sequence.part(first, len(sequence)), reference.pose[first:]
    up = se3.from_rotation_translation(level(part.stamp, pose, series), np.zeros(3))
    limits = f"{reference.limits}; levelled by the mean of the accelerometer"
    digest = hashlib.sha256(
        f"{part.digest}|{first}".encode() + series.accel.tobytes() + series.gyro.tobytes()
    )
    inertial = replace(
        part,
        name=_INERTIAL,
        row=np.arange(part.observations),
        imu=series,
        digest=digest.hexdigest(),
        counts={
            "frames": len(part),
            "frames_before_inertia": first,
            "feature_columns": len(np.unique(part.track)),
            "observations_read": part.observations,
            **series.counts,
        },
    )
    return (
        inertial,
        _reference(up @ pose, limits=limits),
        f"{account}; the run begins at frame {first}, which they cover",
    )


def _reference(pose: Array, *, limits: str) -> Reference:
    return Reference(
        name="batch solution of the same tracks",
        limits=limits,
        frame=np.arange(len(pose)),
        position=pose[:, :3, 3],
        pose=pose,
        imu_T_point=np.eye(4),
    )


def _file(name: str) -> Path:
    found = find_spec("gtsam")
    folders = [] if found is None else found.submodule_search_locations or []
    paths = [Path(folder) / "Data" / name for folder in folders]
    path = next((path for path in paths if path.is_file()), None)
    if path is None:
        raise DataError(f"{name}: not among the example data of the installed gtsam; install gtsam 4.3.0")
    return path


def _rig(imu_T_cam: Array) -> StereoRig:
    table, _ = read_table(_file("VO_calibration00.txt"), columns=6)
    fx, fy, _, cx, cy, baseline = (float(number) for number in table[0])
    return StereoRig(fx, fy, cx, cy, baseline, imu_T_cam)


def _visual_odometry(imu_T_cam: Array) -> tuple[Array, Array]:
    """Numbers of the frames ``(T,)`` and poses ``(T, 4, 4)`` of the body, from the first one."""
    table, _ = read_table(_file("VO_camera_poses00.txt"), columns=17)
    matrix = table[:, 1:].reshape(-1, 4, 4)
    # Six digits are printed; the nearest rotation is taken.
    u, _, vt = np.linalg.svd(matrix[:, :3, :3])
    first_T_cam = se3.from_rotation_translation(u @ vt, matrix[:, :3, 3])
    return table[:, 0], imu_T_cam @ first_T_cam @ se3.inverse(imu_T_cam)


def _sequence(number: Array, world_T_imu: Array, sigma: Array, *, seed: int, imu_T_cam: Array) -> Sequence:
    table, _ = read_table(_file("VO_stereo_factors00.txt"), columns=8)
    frame = np.searchsorted(number, table[:, 0])
    order = np.lexsort((table[:, 1], frame))
    frame, table = frame[order], table[order]
    _, track = np.unique(table[:, 1], return_inverse=True)
    row_of_both = table[:, 4]
    stamp = _PERIOD * number
    dt = np.diff(stamp)[:, None]
    motion = se3.log(se3.inverse(world_T_imu[:-1]) @ world_T_imu[1:]) / dt
    noise = sigma * np.sqrt(_PERIOD / dt) * np.random.default_rng(seed).standard_normal(motion.shape)
    inertial_stamp, twist = piecewise_constant(stamp, motion + noise)
    pixels = np.column_stack([table[:, 2], row_of_both, table[:, 3], row_of_both])
    return Sequence(
        name=_NAME,
        stamp=stamp,
        inertial_stamp=inertial_stamp,
        twist=twist,
        vertical_velocity=np.full(len(inertial_stamp), np.nan),
        rig=_rig(imu_T_cam),
        offset=np.searchsorted(frame, np.arange(len(stamp) + 1)),
        track=track,
        pixels=pixels,
        row=np.arange(len(track)),
        digest=hashlib.sha256(pixels.tobytes() + twist.tobytes()).hexdigest(),
        counts={
            "frames": len(stamp),
            "feature_columns": int(track.max()) + 1,
            "observations_read": len(track),
        },
    )
