"""Two cameras and the rectified pair that is made of them: points are rectified, not images."""

from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array
from vislam.geometry import se3, so3
from vislam.models.camera import Camera
from vislam.models.stereo import StereoRig

_SHORTEST = 1e-4
"""Baseline below which two cameras are one [m]."""


@dataclass(frozen=True)
class StereoPair:
    """A stereo pair as it is, and the rectified one in whose pixels the tracks are given.

    Attributes
    ----------
    left, right : Camera
    rect_R_left, rect_R_right : (3, 3)
        Rotation of each camera's axes into those of the rectified pair.
    rig : StereoRig
        The rectified pair.
    """

    left: Camera
    right: Camera
    rect_R_left: Array
    rect_R_right: Array
    rig: StereoRig

    def rectify_left(self, pixels: Array) -> Array:
        """Rectified pixels ``(n, 2)`` of pixels ``(n, 2)`` of the left image; NaN where there is no ray."""
        return self._rectify(self.left, self.rect_R_left, pixels)

    def rectify_right(self, pixels: Array) -> Array:
        """Rectified pixels ``(n, 2)`` of pixels ``(n, 2)`` of the right image; NaN where there is no ray."""
        return self._rectify(self.right, self.rect_R_right, pixels)

    def raw_left(self, rectified: Array) -> Array:
        """Pixels ``(n, 2)`` of the left image at rectified pixels ``(n, 2)``; NaN if behind the camera."""
        return self._raw(self.left, self.rect_R_left, rectified)

    def raw_right(self, rectified: Array) -> Array:
        """Pixels ``(n, 2)`` of the right image at rectified pixels ``(n, 2)``; NaN if behind the camera."""
        return self._raw(self.right, self.rect_R_right, rectified)

    def turned_right(self, rotation: Array) -> "StereoPair":
        """The pair with its right camera turned by a rotation vector ``(3,)`` [rad] in rectified axes."""
        return replace(self, rect_R_right=so3.exp(rotation) @ self.rect_R_right)

    def _rectify(self, camera: Camera, rect_R_camera: Array, pixels: Array) -> Array:
        rays = _homogeneous(camera.undistort(pixels)) @ rect_R_camera.T
        return _divided(rays) * [self.rig.fx, self.rig.fy] + [self.rig.cx, self.rig.cy]

    def _raw(self, camera: Camera, rect_R_camera: Array, rectified: Array) -> Array:
        rays = _homogeneous((rectified - [self.rig.cx, self.rig.cy]) / [self.rig.fx, self.rig.fy])
        return camera.distort(_divided(rays @ rect_R_camera))


def _homogeneous(points: Array) -> Array:
    return np.column_stack([points, np.ones(len(points))])


def _divided(rays: Array) -> Array:
    """Points ``(n, 2)`` on the plane z = 1; NaN of a ray that points away from it."""
    depth = np.where(rays[:, 2] > 0.0, rays[:, 2], np.nan)
    return np.asarray(rays[:, :2] / depth[:, None])


def rectified(left: Camera, right: Camera, *, imu_T_left: Array, imu_T_right: Array) -> StereoPair:
    """Make the rectified pair of two calibrated cameras.

    Its x axis is the baseline; its z axis is the mean of both optical axes, made perpendicular to it (as
    Fusiello, Trucco and Verri 2000 but for the mean, which treats both images alike). Its focal length is the
    geometric mean of the left camera's, so a pixel stays about a pixel, and its principal point is the middle
    of the left image.

    Parameters
    ----------
    left, right : Camera
    imu_T_left, imu_T_right : (4, 4)
        Poses of the cameras in the body [m].

    Raises
    ------
    ValueError
        If the cameras are in one place, look along their baseline, or the left one is on the right.
    """
    left_T_right = se3.inverse(imu_T_left) @ imu_T_right
    across = left_T_right[:3, 3]
    baseline = float(np.linalg.norm(across))
    if baseline < _SHORTEST:
        raise ValueError(f"baseline must be at least {_SHORTEST:g} m, got {baseline:g} m")
    x = across / baseline
    ahead = np.array([0.0, 0.0, 1.0]) + left_T_right[:3, 2]
    z = ahead - (ahead @ x) * x
    if np.linalg.norm(z) < 0.5 or x[0] < 0.5:
        raise ValueError(
            "the right camera must stand to the right of the left one and look the same way, "
            f"got a baseline of {np.array2string(across, precision=3)} m in the left camera's axes"
        )
    z = z / np.linalg.norm(z)
    rect_R_left = np.vstack([x, np.cross(z, x), z])
    rig = StereoRig(
        fx=float(np.sqrt(left.fx * left.fy)),
        fy=float(np.sqrt(left.fx * left.fy)),
        cx=0.5 * (left.width - 1),
        cy=0.5 * (left.height - 1),
        baseline=baseline,
        imu_T_cam=imu_T_left @ se3.from_rotation_translation(rect_R_left.T, np.zeros(3)),
    )
    return StereoPair(left, right, rect_R_left, rect_R_left @ left_T_right[:3, :3], rig)
