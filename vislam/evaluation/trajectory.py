"""Errors of a whole trajectory: ATE of positions and rotations, path length, drift at the end."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.evaluation.alignment import Alignment, find_alignment
from vislam.evaluation.association import Matched, distance_along
from vislam.geometry import so3


@dataclass(frozen=True)
class Statistics:
    """Summary of many errors, in their unit."""

    rmse: float
    mean: float
    median: float
    max: float

    @classmethod
    def of(cls, values: Array) -> "Statistics":
        """Statistics of errors ``(n,)`` that are not negative, n at least 1."""
        return cls(
            rmse=float(np.sqrt(np.mean(values**2))),
            mean=float(values.mean()),
            median=float(np.median(values)),
            max=float(values.max()),
        )


@dataclass(frozen=True)
class AbsoluteErrors:
    """Errors of an aligned estimate, frame by frame.

    Attributes
    ----------
    frame : (m,)
    position_error : (m, d)
        Estimate less reference [m]; d = 2 if the reference or the alignment is planar.
    rotation_error : (m,) or None
        Angle between the two attitudes [rad], 0 to pi; None for a reference without poses.
    """

    frame: IntArray
    position_error: Array
    rotation_error: Array | None

    @property
    def position(self) -> Statistics:
        """Of the lengths of the position errors [m]; its ``rmse`` is what is called the ATE."""
        return Statistics.of(np.linalg.norm(self.position_error, axis=1))

    @property
    def rotation(self) -> Statistics | None:
        """Of the rotation errors [rad]."""
        return None if self.rotation_error is None else Statistics.of(self.rotation_error)


def ate(matched: Matched, alignment: Alignment) -> AbsoluteErrors:
    """Absolute trajectory errors. Sturm et al. (IROS 2012), and the same for rotations."""
    poses = alignment.transform_poses(matched.estimate)
    dimensions = 2 if matched.planar or alignment.kind == "planar" else 3
    turn = None
    if matched.pose is not None:
        apart = np.swapaxes(poses[:, :3, :3], 1, 2) @ matched.pose[:, :3, :3]
        turn = np.linalg.norm(so3.log(apart), axis=1)
    return AbsoluteErrors(matched.frame, poses[:, :dimensions, 3] - matched.position[:, :dimensions], turn)


def path_length(world_T_imu: Array) -> float:
    """Distance travelled [m]."""
    return float(np.linalg.norm(np.diff(world_T_imu[:, :3, 3], axis=0), axis=1).sum())


def distance_driven(world_T_imu: Array) -> Array:
    """Distance along the path at each pose, ``(T,)`` [m]."""
    return distance_along(world_T_imu[:, :3, 3])


def final_drift(matched: Matched) -> float | None:
    """Position error at the end, with the first pose on the reference's, over the path length [%].

    None if the reference has no poses or does not move.
    """
    if matched.pose is None or not len(matched.frame) or matched.driven[-1] == matched.driven[0]:
        return None
    last = ate(matched, find_alignment("first_pose", matched)).position_error[-1]
    return float(100.0 * np.linalg.norm(last) / (matched.driven[-1] - matched.driven[0]))
