"""A trajectory along recorded poses: a smooth path through them, of which every pose and twist is exact."""

import numpy as np
from scipy.interpolate import make_lsq_spline
from scipy.spatial.transform import Rotation

from vislam.base.types import Array
from vislam.geometry import se3
from vislam.simulation.path import central_twist

_DEGREE = 5
"""Degree of the splines; the twist then has three continuous derivatives."""
FEWEST_POSES = 2 * _DEGREE + 2
"""Fewest poses that a path can be laid through."""


class RecordedPath:
    """World pose of the body by least-squares splines through recorded poses.

    Recorded poses jitter, which would make a twist of pure noise; with several poses to a knot the splines
    leave the jitter out. Positions and unit quaternions, normalised after, are fitted component by component.
    What comes out is a truth of its own, near the recorded one.
    """

    def __init__(self, time: Array, world_T_imu: Array, *, knot_spacing: float) -> None:
        """Fit.

        Parameters
        ----------
        time : (n,)
            Increasing, ``FEWEST_POSES`` or more [s].
        world_T_imu : (n, 4, 4)
        knot_spacing : float
            Time between knots, rounded to whole poses [s].
        """
        quaternion = Rotation.from_matrix(world_T_imu[:, :3, :3]).as_quat()
        # The two quaternions of a rotation: keep to the side of the one before.
        turned = np.sum(quaternion[1:] * quaternion[:-1], axis=1) < 0.0
        quaternion[1:] *= np.where(np.cumsum(turned) % 2 == 1, -1.0, 1.0)[:, None]
        every = max(1, round(knot_spacing / float(np.median(np.diff(time)))))
        # Knots lie on poses, so that each has poses around it even where the recording has a gap.
        inner = time[_DEGREE:-_DEGREE:every]
        knots = np.concatenate([np.repeat(time[0], _DEGREE + 1), inner, np.repeat(time[-1], _DEGREE + 1)])
        self._spline = make_lsq_spline(time, np.hstack([world_T_imu[:, :3, 3], quaternion]), knots, k=_DEGREE)
        self._rise = self._spline.derivative()

    def pose(self, time: Array) -> Array:
        """World pose ``(n, 4, 4)`` of the body at times ``(n,)`` [s], within a second of the recording."""
        value = self._spline(time)
        return se3.from_rotation_translation(Rotation.from_quat(value[:, 3:]).as_matrix(), value[:, :3])

    def twist(self, time: Array) -> Array:
        """Body twist ``(n, 6)`` at times ``(n,)``, by central differences of the pose."""
        return central_twist(self.pose, time)

    def vertical_velocity(self, time: Array) -> Array:
        """Rate of the height ``(n,)`` at times ``(n,)`` [m/s]."""
        return np.asarray(self._rise(time)[:, 2])
