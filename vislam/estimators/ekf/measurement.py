"""The measurements of the joint state: values and Jacobians of stereo sightings.

A landmark is (q, e): three coordinates in a :mod:`chart <vislam.estimators.ekf.chart>`, and the share e by
which its disparity is too large because the right patch follows another point than the left one. With the
point ``h = (x, y, z, w)`` in the left camera, homogeneous,

    uL = fx x / z + cx,    v = fy y / z + cy,    uL - uR = (1 + e) fx b w / z + o,

o being the constant error of all disparities. Nothing here divides by w: points at infinity are welcome.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.estimators.ekf.chart import Chart
from vislam.estimators.ekf.layout import DISPARITY_OFFSET, LANDMARK, NavLayout
from vislam.geometry import se3, so3
from vislam.models import StereoRig
from vislam.models.odometry import POSE

_FARTHEST = 1e-9
"""Smallest w that a depth is taken of: what is farther, or beyond infinity, is very far."""


@dataclass(frozen=True)
class Camera:
    """What turns a landmark into a measurement.

    Attributes
    ----------
    rig : StereoRig
    chart : Chart
    layout : NavLayout
        Of the navigation state that Jacobians are taken by.
    """

    rig: StereoRig
    chart: Chart
    layout: NavLayout

    def view(self, world_T_imu: Array, anchors: Array, landmarks: Array) -> "View":
        """Look at landmarks ``(n, 4)``, their anchors ``(n, 4, 4)`` in the world, from a pose ``(4, 4)``."""
        cam_T_anchor = se3.inverse(world_T_imu @ self.rig.imu_T_cam) @ anchors
        homogeneous = self.chart.homogeneous(landmarks[:, :3])
        in_camera = (cam_T_anchor @ homogeneous[:, :, None])[:, :, 0]
        return View(self, landmarks, homogeneous, cam_T_anchor, in_camera)

    def initialise(self, world_T_imu: Array, z: Array, *, offset: float) -> tuple[Array, Array, Array, Array]:
        """Landmarks from their first measurement (eq. 20), the error of the match taken as 0.

        Returns
        -------
        anchors : (n, 4, 4)
        landmarks : (n, 4)
        by_nav : (n, 4, d_nav)
            Derivative with respect to the navigation state.
        by_measurement : (n, 4, 4)
            Derivative with respect to (uL, uR, v) and to the error of the match.
        """
        rig, chart, n = self.rig, self.chart, len(z)
        world_T_cam = world_T_imu @ rig.imu_T_cam
        anchor = world_T_cam if chart.anchored else np.eye(4)
        anchor_T_cam = np.eye(4) if chart.anchored else world_T_cam
        disparity = z[:, 0] - z[:, 1] - offset
        per_disparity = 1.0 / (rig.fx * rig.baseline)
        in_camera = np.column_stack(
            [
                (z[:, 0] - rig.cx) / rig.fx,
                (z[:, 2] - rig.cy) / rig.fy,
                np.ones(n),
                disparity * per_disparity,
            ]
        )
        in_anchor = in_camera @ anchor_T_cam.T
        landmarks = np.zeros((n, LANDMARK))
        landmarks[:, :3] = chart.coordinates(in_anchor)
        by_camera = chart.coordinates_jacobian(in_anchor) @ anchor_T_cam
        by_measurement = np.zeros((n, LANDMARK, 4))
        by_measurement[:, :3, 0] = by_camera[:, :, 0] / rig.fx + by_camera[:, :, 3] * per_disparity
        by_measurement[:, :3, 1] = -by_camera[:, :, 3] * per_disparity
        by_measurement[:, :3, 2] = by_camera[:, :, 1] / rig.fy
        # The disparity of the point itself is (uL - uR - o) / (1 + e).
        by_measurement[:, :3, 3] = by_measurement[:, :3, 1] * disparity[:, None]
        by_measurement[:, 3, 3] = 1.0
        by_nav = np.zeros((n, LANDMARK, self.layout.size))
        imu_to_anchor = se3.adjoint(se3.inverse(anchor) @ world_T_imu)
        by_nav[:, :3, POSE] = chart.moved(landmarks[:, :3]) @ imu_to_anchor
        if DISPARITY_OFFSET in self.layout:
            by_nav[:, :3, self.layout[DISPARITY_OFFSET]] = by_measurement[:, :3, 1:2]
        return np.broadcast_to(anchor, (n, 4, 4)), landmarks, by_nav, by_measurement


@dataclass(frozen=True)
class View:
    """Landmarks as a camera sees them.

    Attributes
    ----------
    camera : Camera
    landmarks : (n, 4)
    homogeneous : (n, 4)
        Their points in their anchors.
    cam_T_anchor : (n, 4, 4)
    in_camera : (n, 4)
        Their points in the left camera, of the same scale.
    """

    camera: Camera
    landmarks: Array
    homogeneous: Array
    cam_T_anchor: Array
    in_camera: Array

    @property
    def depth(self) -> Array:
        """Depth ``(n,)`` in the left camera [m], negative behind it."""
        return np.asarray(self.in_camera[:, 2] / np.maximum(self.in_camera[:, 3], _FARTHEST))

    def measurement(self, offset: float) -> Array:
        """Measurements (uL, uR, v), ``(n, 3)`` [px], all disparities being too large by ``offset`` [px]."""
        rig = self.camera.rig
        x, y, z, w = self.in_camera.T
        column = rig.fx * x / z + rig.cx
        disparity = (1.0 + self.landmarks[:, 3]) * rig.fx * rig.baseline * w / z + offset
        return np.column_stack([column, column - disparity, rig.fy * y / z + rig.cy])

    def jacobians(self) -> tuple[Array, Array]:
        """H of :meth:`measurement`.

        Returns
        -------
        by_nav : (n, 3, d_nav)
            With respect to the navigation state. Its pose block is minus the derivative that the report's
            eq. (26) has, whose sign and inverse are wrong.
        by_landmark : (n, 3, 4)
            With respect to the landmark (eq. 19, by the chain rule) and to the error of its match.
        """
        rig = self.camera.rig
        x, y, z, w = self.in_camera.T
        stretch = 1.0 + self.landmarks[:, 3]
        disparity = rig.fx * rig.baseline * w / z
        by_camera = np.zeros((len(z), 3, 4))
        by_camera[:, 0, 0] = by_camera[:, 1, 0] = rig.fx / z
        by_camera[:, 0, 2] = by_camera[:, 1, 2] = -rig.fx * x / z**2
        by_camera[:, 2, 1] = rig.fy / z
        by_camera[:, 2, 2] = -rig.fy * y / z**2
        by_camera[:, 1, 2] += stretch * disparity / z
        by_camera[:, 1, 3] = -stretch * rig.fx * rig.baseline / z
        in_imu = self.in_camera @ rig.imu_T_cam[:3].T
        by_imu = by_camera[:, :, :3] @ rig.cam_T_imu[:3, :3]
        layout = self.camera.layout
        by_nav = np.zeros((len(z), 3, layout.size))
        by_nav[:, :, :3] = by_imu @ so3.hat(in_imu)
        by_nav[:, :, 3:6] = -w[:, None, None] * by_imu
        if DISPARITY_OFFSET in layout:
            by_nav[:, 1, layout[DISPARITY_OFFSET]] = -1.0
        by_landmark = np.empty((len(z), 3, LANDMARK))
        by_landmark[:, :, :3] = by_camera @ (self.cam_T_anchor @ self.camera.chart.linear)
        by_landmark[:, :, 3] = 0.0
        by_landmark[:, 1, 3] = -disparity
        return by_nav, by_landmark

    def drift_cov(self, drift: float) -> Array:
        """Covariance ``(n, 3, 3)`` of a step of ``drift`` [px] in column and row, at constant depth."""
        rig = self.camera.rig
        lateral = self.cam_T_anchor[:, :2, :3].transpose(0, 2, 1) * (
            self.in_camera[:, 2, None, None] * np.array([drift / rig.fx, drift / rig.fy])
        )
        step = self.camera.chart.coordinates_jacobian(self.homogeneous)[:, :, :3] @ lateral
        return np.asarray(step @ step.transpose(0, 2, 1))
