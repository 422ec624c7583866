"""Trajectories and maps in the formats other tools read."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.base.files import replace_whole
from vislam.base.types import Array
from vislam.core.run import Run


def write_tum(path: Path, stamp: Array, world_T_imu: Array) -> None:
    """Write poses ``(T, 4, 4)`` as TUM lines ``stamp x y z qx qy qz qw`` [s, m]."""
    quaternion = Rotation.from_matrix(world_T_imu[:, :3, :3]).as_quat()
    table = np.column_stack([stamp, world_T_imu[:, :3, 3], quaternion])
    with replace_whole(path) as temporary:
        np.savetxt(temporary, table, fmt="%.9f")


def write_kitti(path: Path, world_T_imu: Array) -> None:
    """Write poses ``(T, 4, 4)`` as KITTI lines, the upper three rows of each matrix, row by row.

    They are what the estimator states: the body, not the camera, in a world with z up. KITTI's own files have
    the left camera in the axes of its first pose.
    """
    with replace_whole(path) as temporary:
        np.savetxt(temporary, world_T_imu[:, :3].reshape(-1, 12), fmt="%.9e")


def write_npz(path: Path, run: Run) -> None:
    """Write a run's trajectory and map for other programs, as compressed arrays without pickled objects.

    ``stamp (T,)``
        Camera times [s].
    ``world_T_imu``, ``world_T_imu_filtered (T, 4, 4)``
        Poses of the body as known in the end, and as known at their own time.
    ``pose_cov``, ``pose_cov_filtered (T, 6, 6)``
        Their covariances, in the order (omega [rad], v [m]), of a perturbation on the right. NaN where the
        estimator gave none.
    ``pose_cov_considered``, ``pose_cov_filtered_considered``, ``pose_cov_sandwich``, ... ``(T, 6, 6)``
        The same with the errors that all observations share, and by the scores of blocks of time; missing
        where the run has none.
    ``up (3,)``
        Direction of up in the world; z where the estimator does not know better.
    ``track (m,)``, ``points_world (m, 3)``
        Ids of the landmarks and their places [m].
    ``points_cov (m, 3, 3)``
        Their covariances [m^2]; missing where the estimator gave none.
    """
    final, filtered, landmarks = run.final, run.filtered, run.landmarks
    arrays = {
        "stamp": run.stamp,
        "world_T_imu": final.world_T_imu,
        "world_T_imu_filtered": filtered.world_T_imu,
        "pose_cov": final.covariances,
        "pose_cov_filtered": filtered.covariances,
        "up": run.up,
        "track": landmarks.track,
        "points_world": landmarks.points_world,
    }
    if landmarks.points_cov is not None:
        arrays["points_cov"] = landmarks.points_cov
    for kind in run.beside:
        other = run.with_covariances(kind)
        arrays[f"pose_cov_{kind}"] = other.final.covariances
        arrays[f"pose_cov_filtered_{kind}"] = other.filtered.covariances
    with replace_whole(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def write_ply(path: Path, points_world: Array) -> None:
    """Write points ``(n, 3)`` [m] as an ASCII PLY file."""
    header = (
        f"ply\nformat ascii 1.0\nelement vertex {len(points_world)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header"
    )
    with replace_whole(path) as temporary:
        np.savetxt(temporary, points_world, fmt="%.4f", header=header, comments="")
