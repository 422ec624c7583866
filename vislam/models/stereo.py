"""Rectified stereo pair: projection, back-projection and their Jacobians, vectorised over points.

The measurement is ``z = (uL, uR, v)`` in px (GTSAM's ``StereoPoint2``), with v the mean row of the
two images. It carries the same information on pose and landmark as the report's
``(uL, vL, uR, vR)`` with variance s^2 each, when v is given the variance s^2 / 2.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vislam.base.types import Array
from vislam.geometry import se3

CAMERA_AXES = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""Rotation from a level, forward-looking camera to the body."""


@dataclass(frozen=True)
class StereoRig:
    """Intrinsics, baseline and mounting of a rectified stereo pair.

    Attributes
    ----------
    fx, fy, cx, cy : float
        Focal lengths and principal point [px], the same for both images.
    baseline : float
        Distance between the cameras [m]; the right one is at ``(baseline, 0, 0)`` in ``cam``.
    imu_T_cam : (4, 4)
        Pose of the left camera in the body frame.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    baseline: float
    imu_T_cam: Array

    @cached_property
    def cam_T_imu(self) -> Array:
        """Pose of the body in the left camera, ``(4, 4)``."""
        return se3.inverse(self.imu_T_cam)

    @property
    def nearest(self) -> float:
        """Depth at which a disparity is as wide as the image [m]: nothing nearer is in both images."""
        return self.fx * self.baseline / (2.0 * self.cx) if self.cx > 0.0 else self.baseline

    def copy(self) -> "StereoRig":
        """The same rig with arrays of its own."""
        return replace(self, imu_T_cam=self.imu_T_cam.copy())

    def project(self, points_cam: Array) -> Array:
        """Measurement ``(n, 3)`` [px] of points ``(n, 3)`` [m] in the left camera frame.

        Barfoot, *State Estimation for Robotics* (2017), section 6.4.2, with the mean row (course report, eq.
        7).
        """
        x, y, z = np.moveaxis(points_cam, -1, 0)
        return np.stack(
            [
                self.fx * x / z + self.cx,
                self.fx * (x - self.baseline) / z + self.cx,
                self.fy * y / z + self.cy,
            ],
            axis=-1,
        )

    def projection_jacobian(self, points_cam: Array) -> Array:
        """Derivative of :meth:`project`, ``(n, 3, 3)`` [px/m] (course report, eq. 17, calibrated)."""
        x, y, z = np.moveaxis(points_cam, -1, 0)
        out = np.zeros((*points_cam.shape, 3))
        out[..., 0, 0] = out[..., 1, 0] = self.fx / z
        out[..., 0, 2] = -self.fx * x / z**2
        out[..., 1, 2] = -self.fx * (x - self.baseline) / z**2
        out[..., 2, 1] = self.fy / z
        out[..., 2, 2] = -self.fy * y / z**2
        return out

    def back_project(self, z: Array) -> Array:
        """Points ``(n, 3)`` [m] in the left camera frame of measurements ``(n, 3)`` [px].

        The inverse of :meth:`project`; in the course report's eq. 20, y does not come from the row as it
        should, ``y = (v - cy) z / fy``. The disparity ``uL - uR`` must not be zero.
        """
        depth = self.fx * self.baseline / (z[..., 0] - z[..., 1])
        return np.stack(
            [
                (z[..., 0] - self.cx) * depth / self.fx,
                (z[..., 2] - self.cy) * depth / self.fy,
                depth,
            ],
            axis=-1,
        )

    def back_projection_jacobian(self, z: Array) -> Array:
        """Derivative of :meth:`back_project`, ``(n, 3, 3)`` [m/px]."""
        disparity = z[..., 0] - z[..., 1]
        depth = self.fx * self.baseline / disparity
        slope = depth / disparity
        x, y = (z[..., 0] - self.cx) / self.fx, (z[..., 2] - self.cy) / self.fy
        out = np.zeros((*z.shape, 3))
        for row, ray in enumerate((x, y, np.ones_like(x))):
            out[..., row, 0] = -ray * slope
            out[..., row, 1] = ray * slope
        out[..., 0, 0] += depth / self.fx
        out[..., 1, 2] = depth / self.fy
        return out
