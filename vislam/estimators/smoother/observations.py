"""All stereo observations of a drive as arrays, and their linearisation at once.

The residuals are those of GTSAM's ``GenericStereoFactor3D``: whitened by their standard deviations, weighted
by the kernel, and with no Jacobian where a point is not in front of the camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.estimators.smoother.tracks import Track
from vislam.geometry import so3
from vislam.models import Kernel, StereoRig


@dataclass(frozen=True)
class Linearised:
    """Whitened residuals of observations and their Jacobians.

    Attributes
    ----------
    residual : (n, 3)
        Prediction less measurement.
    by_pose : (n, 3, 6)
        By the error on the right of the pose.
    by_point : (n, 3, 3)
        By the point in the world's axes.
    """

    residual: Array
    by_pose: Array
    by_point: Array


@dataclass(frozen=True)
class Observations:
    """Stereo observations, track after track.

    Attributes
    ----------
    frame, landmark : (n,)
        Frame, and index of the track.
    z, sigma : (n, 3)
        (uL, uR, v) and standard deviations [px].
    """

    frame: IntArray
    landmark: IntArray
    z: Array
    sigma: Array

    @classmethod
    def of(cls, tracks: Sequence[Track]) -> "Observations":
        """Observations of tracks."""
        views = list(chain.from_iterable(track.views for track in tracks))
        return cls(
            np.array([view.k for view in views], dtype=np.int64),
            np.repeat(np.arange(len(tracks)), [len(track.views) for track in tracks]),
            np.array([view.z for view in views]).reshape(-1, 3),
            np.array([view.sigma for view in views]).reshape(-1, 3),
        )

    def span(self, landmarks: int) -> tuple[IntArray, IntArray]:
        """First and last frame ``(landmarks,)`` of each track."""
        first, last = np.full(landmarks, np.iinfo(np.int64).max), np.full(landmarks, -1)
        np.minimum.at(first, self.landmark, self.frame)
        np.maximum.at(last, self.landmark, self.frame)
        return first, last

    def squared(self, rig: StereoRig, poses: Array, points: Array) -> Array:
        """Squared norms ``(n,)`` of the whitened residuals at poses ``(T, 4, 4)`` and points ``(m, 3)``."""
        _, points_cam, behind = self._in_camera(rig, poses, points)
        residual = self._residual(rig, points_cam, behind)
        return np.einsum("ni,ni->n", residual, residual)

    def linearise(self, rig: StereoRig, poses: Array, points: Array, *, kernel: Kernel | None) -> Linearised:
        """Linearise at poses ``(T, 4, 4)`` of the body and points ``(m, 3)`` in the world [m].

        With the axes ``a_x, a_y, a_z`` of the camera in the body, the rows of the Jacobian by the point in
        the body are ``(fx a_x - (uL - cx) a_z) / depth``, the same with uR, and ``(fy a_y - (v - cy) a_z) /
        depth``; a row r by the point is ``r x p`` by the rotation of the body, and ``-r`` by its translation.
        """
        points_imu, points_cam, behind = self._in_camera(rig, poses, points)
        residual = self._residual(rig, points_cam, behind)
        weight = 1.0 / (self.sigma * points_cam[:, 2:])
        weight[behind] = 0.0
        if kernel is not None:
            root = np.sqrt(kernel.weight(np.einsum("ni,ni->n", residual, residual)))[:, None]
            residual, weight = root * residual, root * weight
        x_axis, y_axis, z_axis = rig.cam_T_imu[:3, :3]
        across = np.stack([rig.fx * x_axis, rig.fx * x_axis, rig.fy * y_axis])
        pixel = rig.project(points_cam) - [rig.cx, rig.cx, rig.cy]
        by_point_imu = weight[:, :, None] * (across - pixel[:, :, None] * z_axis)
        by_pose = np.concatenate([by_point_imu @ so3.hat(points_imu), -by_point_imu], axis=2)
        by_point = by_point_imu @ poses[self.frame, :3, :3].transpose(0, 2, 1)
        return Linearised(residual, by_pose, by_point)

    def _in_camera(self, rig: StereoRig, poses: Array, points: Array) -> tuple[Array, Array, BoolArray]:
        """Points ``(n, 3)`` in body and camera, and which are behind it; those are on its axis instead."""
        moved = points[self.landmark] - poses[self.frame, :3, 3]
        points_imu = np.einsum("ni,nij->nj", moved, poses[self.frame, :3, :3])
        points_cam = points_imu @ rig.imu_T_cam[:3, :3] + rig.cam_T_imu[:3, 3]
        behind = points_cam[:, 2] <= 0.0
        points_cam[behind] = [0.0, 0.0, 1.0]
        return points_imu, points_cam, behind

    def _residual(self, rig: StereoRig, points_cam: Array, behind: BoolArray) -> Array:
        residual = (rig.project(points_cam) - self.z) / self.sigma
        residual[behind] = 2.0 * rig.fx / self.sigma[behind]
        return residual
