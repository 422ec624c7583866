"""Trajectory errors: ATE, path length and the drift that KITTI's odometry benchmark defines."""

from dataclasses import dataclass

import numpy as np

from vislam.data.reference import Reference
from vislam.evaluation.alignment import align
from vislam.geometry import se3, so3
from vislam.types import Array, IntArray

KITTI_LENGTHS = tuple(range(100, 900, 100))
"""Segment lengths of the KITTI odometry benchmark [m]."""
_KITTI_STRIDE = 10


@dataclass(frozen=True)
class Aligned:
    """An estimate matched with a reference and rigidly aligned to it.

    Attributes
    ----------
    frame : (m,)
    error : (m, d)
        Position errors [m], d = 2 where the reference is planar.
    rotation : (d, d)
    translation : (d,)
        The alignment.
    planar : bool
    """

    frame: IntArray
    error: Array
    rotation: Array
    translation: Array
    planar: bool

    @property
    def ate(self) -> float:
        """Root mean square of the position error [m]."""
        return float(np.sqrt(np.mean(np.sum(self.error**2, axis=1))))


def match(world_T_imu: Array, reference: Reference, *, planar: bool) -> Aligned:
    """Match by frame, move to the reference's point, align rigidly."""
    inside = reference.frame < len(world_T_imu)
    frame = reference.frame[inside]
    dimensions = 2 if planar else 3
    estimate = (world_T_imu[frame] @ reference.imu_T_point)[:, :dimensions, 3]
    target = reference.position[inside][:, :dimensions]
    rotation, translation = align(estimate, target)
    return Aligned(frame, estimate @ rotation.T + translation - target, rotation, translation, planar)


def path_length(world_T_imu: Array) -> float:
    """Length of the way driven [m]."""
    return float(np.linalg.norm(np.diff(world_T_imu[:, :3, 3], axis=0), axis=1).sum())


def distance_driven(world_T_imu: Array) -> Array:
    """Distance along the path at each pose, ``(T,)`` [m]."""
    steps = np.linalg.norm(np.diff(world_T_imu[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def kitti_drift(estimate: Array, reference: Array) -> tuple[float, float] | None:
    """Mean relative drift over segments of 100 to 800 m, as the KITTI odometry kit defines it.

    Parameters
    ----------
    estimate, reference : (m, 4, 4)
        Matched poses of consecutive frames, same point, same axes.

    Returns
    -------
    t_rel, r_rel : float
        Translation drift [%] and rotation drift [deg/100 m]; None if no segment is long enough.
    """
    driven = distance_driven(reference)
    drifts = []
    for first in range(0, len(reference), _KITTI_STRIDE):
        for length in KITTI_LENGTHS:
            last = int(np.searchsorted(driven, driven[first] + length, side="right"))
            if last >= len(reference):
                break
            wanted = se3.inverse(reference[first]) @ reference[last]
            got = se3.inverse(estimate[first]) @ estimate[last]
            error = se3.inverse(got) @ wanted
            turn = float(np.linalg.norm(so3.log(error[:3, :3])))
            drifts.append((float(np.linalg.norm(error[:3, 3])) / length, turn / length))
    if not drifts:
        return None
    translation, rotation = np.mean(drifts, axis=0)
    return float(100.0 * translation), float(np.rad2deg(100.0 * rotation))
