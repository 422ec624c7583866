"""Trajectories and maps in the formats other tools read."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.files import replace_whole
from vislam.types import Array


def write_tum(path: Path, stamp: Array, world_T_imu: Array) -> None:
    """Write poses ``(T, 4, 4)`` as TUM lines ``stamp x y z qx qy qz qw`` [s, m]."""
    quaternion = Rotation.from_matrix(world_T_imu[:, :3, :3]).as_quat()
    table = np.column_stack([stamp, world_T_imu[:, :3, 3], quaternion])
    with replace_whole(path) as temporary:
        np.savetxt(temporary, table, fmt="%.9f")


def write_ply(path: Path, points_world: Array) -> None:
    """Write points ``(n, 3)`` [m] as an ASCII PLY file."""
    header = (
        f"ply\nformat ascii 1.0\nelement vertex {len(points_world)}\n"
        "property float x\nproperty float y\nproperty float z\nend_header"
    )
    with replace_whole(path) as temporary:
        np.savetxt(temporary, points_world, fmt="%.4f", header=header, comments="")
