"""What is wrong with a trajectory by truth or reference, for :mod:`benchmarks.held_out_ranking`."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.core.reference import Reference
from vislam.evaluation.alignment import find_alignment
from vislam.evaluation.association import associate
from vislam.evaluation.trajectory import ate, distance_driven
from vislam.geometry import se3, so3
from vislam.models import StereoRig

_AHEAD = np.array([0.0, 0.0, 20.0])
"""A point in front of the left camera [m]."""


@dataclass(frozen=True)
class Errors:
    """Errors of a trajectory; all but the first over stretches of the way, from every frame on.

    Attributes
    ----------
    ate : float
        RMSE of the position, rigidly aligned [m].
    way_10, way_100 : float
        Mean error of the left camera's way over 10 m and over 100 m [% of the length].
    turn_10 : float
        Mean error of the turn over 10 m [deg].
    across_10 : float
        Mean error over 10 m of where a point 20 m ahead lies, across the line of sight [m].
    """

    ate: float
    way_10: float
    way_100: float
    turn_10: float
    across_10: float


AXES: Mapping[str, str] = {
    "ate": "ATE [m]",
    "way_10": "way 10 m [%]",
    "way_100": "way 100 m [%]",
    "turn_10": "turn 10 m [deg]",
    "across_10": "across 10 m [m]",
}
"""Short names of the errors."""


def errors(world_T_imu: Array, reference: Reference, rig: StereoRig) -> Errors:
    """Compare a trajectory ``(T, 4, 4)`` with a reference that has poses.

    Raises
    ------
    DataError
        If they have less than 100 m in common.
    """
    inside = reference.frame < len(world_T_imu)
    estimate = world_T_imu[reference.frame[inside]] @ rig.imu_T_cam
    wanted = poses(reference)[inside] @ rig.imu_T_cam
    near, far = (_stretches(length, estimate, wanted) for length in (10.0, 100.0))
    frame = np.arange(len(world_T_imu))
    matched = associate(frame, frame.astype(float), world_T_imu, reference)
    across = (se3.transform(near, _AHEAD[None, None])[:, 0] - _AHEAD)[:, :2]
    return Errors(
        ate=ate(matched, find_alignment("se3", matched)).position.rmse,
        way_10=100.0 * _mean_norm(near[:, :3, 3]) / 10.0,
        way_100=_mean_norm(far[:, :3, 3]),
        turn_10=float(np.rad2deg(_mean_norm(so3.log(near[:, :3, :3])))),
        across_10=_mean_norm(across),
    )


def poses(reference: Reference) -> Array:
    """Poses ``(m, 4, 4)`` of the body by a reference that has poses."""
    assert reference.pose is not None
    return np.asarray(reference.pose @ se3.inverse(reference.imu_T_point))


def _stretches(length: float, estimate: Array, wanted: Array) -> Array:
    """Motion ``(s, 4, 4)`` that an estimate is off by over every stretch of a length [m]."""
    driven = distance_driven(wanted)
    last = np.searchsorted(driven, driven + length)
    first = np.flatnonzero(last < len(driven))
    if not len(first):
        raise DataError(f"errors over {length:g} m need a drive of that length, got {driven[-1]:.1f} m")
    motion, right = (se3.inverse(of[first]) @ of[last[first]] for of in (estimate, wanted))
    return np.asarray(se3.inverse(right) @ motion)


def _mean_norm(vectors: Array) -> float:
    """Mean length of vectors, one a row."""
    return float(np.linalg.norm(vectors, axis=1).mean())
