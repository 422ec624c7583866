"""Poses out of OXTS samples, at any stamps: what a KITTI raw drive is compared with."""

import numpy as np
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from vislam.base.types import Array
from vislam.core.images import StampedPoses
from vislam.geometry import se3

_EARTH = 6378137.0
"""Radius of the sphere of the projection [m]."""
_LONGEST_GAP = 0.3
"""Between two samples [s]: in it a car turns by less than a milliradian off the straight interpolation."""


def oxts_poses(at: Array, table: Array, stamp: Array) -> StampedPoses:
    """Poses of the body between samples.

    The position is KITTI's: a Mercator projection with the scale of the first latitude (``convertOxtsToPose``
    of its development kit); between two samples it is a cubic that has the measured velocities at both ends.
    The attitude is roll, pitch and yaw, interpolated at a constant rate.

    Parameters
    ----------
    at : (S,)
        Stamps of the samples, increasing [s].
    table : (S, 30)
        The samples.
    stamp : (T,)
        Where poses are wanted [s]; those outside the samples, and inside gaps above 0.3 s, have none.
    """
    after = np.clip(np.searchsorted(at, stamp), 1, len(at) - 1)
    inside = (stamp >= at[0]) & (stamp <= at[-1]) & (at[after] - at[after - 1] <= _LONGEST_GAP)
    wanted = stamp[inside]
    east_north_up = table[:, [7, 6, 10]]
    position = CubicHermiteSpline(at, _position(table), east_north_up)(wanted)
    attitude = Rotation.from_euler("ZYX", table[:, [5, 4, 3]])
    rotation = Slerp(at, attitude)(wanted).as_matrix() if len(wanted) else np.empty((0, 3, 3))
    return StampedPoses(
        stamp=wanted,
        world_T_imu=se3.from_rotation_translation(rotation, position),
        origin="OXTS (GNSS/INS), interpolated at the image stamps",
        name="OXTS",
    )


def _position(table: Array) -> Array:
    """East, north, up of the first sample, ``(S, 3)`` [m]."""
    latitude, longitude = np.radians(table[:, 0]), np.radians(table[:, 1])
    scale = _EARTH * np.cos(latitude[0])
    north = scale * np.log(np.tan(0.25 * np.pi + 0.5 * latitude))
    position = np.column_stack([scale * longitude, north, table[:, 2]])
    return np.asarray(position - position[0])
