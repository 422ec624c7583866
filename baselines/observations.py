"""Stereo observations of points from a pose, with both derivatives.

Barfoot, *State Estimation for Robotics* (2017), sections 6.4.2 (stereo camera) and 7.1.8 (homogeneous
points); the course report's eqs. 16 to 19 and 26.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.core.frame import Frame
from vislam.geometry import se3, so3
from vislam.models import StereoRig
from vislam.models.track_noise import SHARES

NEAREST = 0.5
"""A point that would be nearer than this, or behind the camera, is not seen [m]."""
SMALLEST_DISPARITY = 0.5
"""An observation of less has no depth [px]."""


@dataclass(frozen=True)
class Observations:
    """What is seen of points; without a meaning where the depth is less than ``NEAREST``.

    Attributes
    ----------
    depth : (n,)
        Depth in the left camera [m].
    z : (n, 3)
        (uL, uR, v) [px].
    by_pose : (n, 3, 6)
        Derivative of ``z`` by the pose, on its right: the circle-dot operator of the point in the
        body with a minus, which the course report's eq. 26 lacks together with the inverse.
    by_point : (n, 3, 3)
        Derivative of ``z`` by the point (eq. 19).
    """

    depth: Array
    z: Array
    by_pose: Array
    by_point: Array

    def select(self, which: BoolArray) -> "Observations":
        """Those of a mask."""
        return Observations(self.depth[which], self.z[which], self.by_pose[which], self.by_point[which])


def look(rig: StereoRig, world_T_imu: Array, points_world: Array) -> Observations:
    """Look at points ``(n, 3)`` [m] from a pose ``(4, 4)``.

    With ``T = world_T_imu exp(omega, v)`` and s the point in the body, ``T^-1 m`` changes by
    ``s x omega - v``: minus the circle-dot operator (Barfoot 2017, section 7.1.8).
    """
    in_imu = se3.transform(se3.inverse(world_T_imu), points_world)
    in_camera = se3.transform(rig.cam_T_imu, in_imu)
    depth = in_camera[:, 2]
    held = np.column_stack([in_camera[:, :2], np.maximum(depth, NEAREST)])
    by_imu = rig.projection_jacobian(held) @ rig.cam_T_imu[:3, :3]
    return Observations(
        depth=depth,
        z=rig.project(held),
        by_pose=np.concatenate([by_imu @ so3.hat(in_imu), -by_imu], axis=2),
        by_point=by_imu @ world_T_imu[:3, :3].T,
    )


def pixel_variances(frame: Frame, pixel_variance: float | None) -> Array:
    """Variances ``(n, 3)`` of (uL, uR, v) [px^2]: that of each pixel coordinate given, or those of the frame.

    The mean row has half the variance of a coordinate: the same information as the report's four rows.
    """
    if pixel_variance is None:
        return frame.stereo.sigma**2
    return np.broadcast_to(pixel_variance * SHARES**2, (len(frame.stereo.track), 3))
