"""The measurements of the joint state: values and Jacobians of stereo observations.

A landmark is (q, e): three coordinates in a :mod:`parametrisation <vislam.estimators.ekf.parametrisation>`,
and the share e by which its disparity is too large because the right patch follows another point than the
left one. With the point ``h = (x, y, z, w)`` in the left camera, homogeneous,

    uL = fx x / z + cx,    v = fy y / z + cy,    uL - uR = (1 + e) fx b w / z + o,

o being the error of all disparities; the other errors that all tracks share (rotation of the cameras,
principal point, focal scale; :mod:`vislam.models.shared_errors`) are in the mounting and in fx, fy, cx, cy.
Nothing here divides by w: points at infinity are welcome.

A landmark's anchor is the camera as estimated at its first observation, and stays there; the
parametrisation is that of the stated rig. Of shared errors its coordinates know by that observation alone:
with ``z = h(nav, q)``,

    dq / dnav = -(dh / dq)^-1 dh / dnav,

the anchor held. As a rotation of the cameras is to them a rotation of the body, its column in every Jacobian
is that of the rotation of the pose times ``J_l(psi)``. Neither pose nor landmarks have part in an error that
is shared, so a motion of the world, which changes no observation whatever these errors are, leaves them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vislam.base.types import Array
from vislam.estimators.ekf.layout import LANDMARK, NavLayout
from vislam.estimators.ekf.parametrisation import Parametrisation
from vislam.geometry import se3, so3
from vislam.models import CameraErrors, StereoRig
from vislam.models.odometry import POSE
from vislam.models.shared_errors import CAMERA_ROTATION, OF_CAMERA

_FARTHEST = 1e-9
"""Smallest w that a depth is taken of: what is farther, or beyond infinity, is very far."""
_NO_ERRORS = CameraErrors()
_IDENTITY = np.eye(4)


@dataclass(frozen=True)
class Camera:
    """What turns a landmark into a measurement.

    Attributes
    ----------
    rig : StereoRig
        As stated.
    parametrisation : Parametrisation
    layout : NavLayout
        Of the navigation state that Jacobians are taken by.
    """

    rig: StereoRig
    parametrisation: Parametrisation
    layout: NavLayout

    @cached_property
    def observed(self) -> int:
        """The first so many components of the navigation state are all that observations depend on.

        Of those behind the pose that is the shared errors of the camera, which stand last.
        """
        return self.layout.size if self._has_errors else POSE.stop

    @cached_property
    def _has_errors(self) -> bool:
        return any(name in self.layout for name in OF_CAMERA)

    def errors(self, nav: Array) -> CameraErrors:
        """Shared errors of a navigation state ``(d_nav,)``."""
        if not self._has_errors:
            return _NO_ERRORS
        return CameraErrors.of({name: nav[self.layout[name]] for name in OF_CAMERA if name in self.layout})

    def actual(self, errors: CameraErrors) -> StereoRig:
        """Rig with these errors; the stated one where the layout has none."""
        return errors.rig(self.rig) if self._has_errors else self.rig

    def view(self, world_T_imu: Array, nav: Array, anchors: Array, landmarks: Array) -> "View":
        """Look at landmarks from a pose, with the shared errors of a navigation state.

        Parameters
        ----------
        world_T_imu : (4, 4)
        nav : (d_nav,)
        anchors : (n, 4, 4)
            Of the landmarks, in the world.
        landmarks : (n, 4)
        """
        errors = self.errors(nav)
        rig = self.actual(errors)
        cam_T_anchor = se3.inverse(world_T_imu @ rig.imu_T_cam)
        homogeneous = self.parametrisation.homogeneous(landmarks[:, :3])
        if self.parametrisation.anchored:
            cam_T_anchor = cam_T_anchor @ anchors
            in_camera = (cam_T_anchor @ homogeneous[:, :, None])[:, :, 0]
        else:
            in_camera = homogeneous @ cam_T_anchor.T
        return View(self, errors, rig, landmarks, homogeneous, cam_T_anchor, in_camera)

    def initialise(self, world_T_imu: Array, nav: Array, z: Array) -> tuple[Array, Array, Array, Array]:
        """Landmarks triangulated from their first observation, the stereo-matching bias taken as 0.

        Parameters
        ----------
        world_T_imu : (4, 4)
        nav : (d_nav,)
            Navigation state, whose shared errors the camera has.
        z : (n, 3)
            Measurements (uL, uR, v) [px].

        Returns
        -------
        anchors : (n, 4, 4)
        landmarks : (n, 4)
        by_nav : (n, s, c)
            Derivative of the landmark's error, of the layout's size s, with respect to the first c components
            of the navigation state, those that are :attr:`observed`.
        by_measurement : (n, s, s)
            Derivative with respect to (uL, uR, v) and to the stereo-matching bias, if it is in the error.
        """
        errors, parametrisation, n = self.errors(nav), self.parametrisation, len(z)
        rig = self.actual(errors)
        world_T_cam = world_T_imu @ rig.imu_T_cam
        if parametrisation.anchored:
            anchor, anchor_T_cam, imu_T_anchor = world_T_cam, _IDENTITY, rig.imu_T_cam
        else:
            anchor, anchor_T_cam, imu_T_anchor = _IDENTITY, world_T_cam, se3.inverse(world_T_imu)
        disparity = z[:, 0] - z[:, 1] - errors.disparity_offset
        per_disparity = 1.0 / (rig.fx * rig.baseline)
        in_camera = np.ones((n, 4))
        in_camera[:, 0], in_camera[:, 1] = (z[:, 0] - rig.cx) / rig.fx, (z[:, 2] - rig.cy) / rig.fy
        in_camera[:, 3] = disparity * per_disparity
        in_anchor = in_camera @ anchor_T_cam.T
        landmarks = np.zeros((n, LANDMARK))
        landmarks[:, :3] = parametrisation.coordinates(in_anchor)
        by_camera = parametrisation.coordinates_jacobian(in_anchor) @ anchor_T_cam
        size = self.layout.landmark
        by_measurement = np.zeros((n, size, size))
        by_measurement[:, :3, 0] = by_camera[:, :, 0] / rig.fx + by_camera[:, :, 3] * per_disparity
        by_measurement[:, :3, 1] = -by_camera[:, :, 3] * per_disparity
        by_measurement[:, :3, 2] = by_camera[:, :, 1] / rig.fy
        if size == LANDMARK:
            # The disparity of the point itself is (uL - uR - o) / (1 + e).
            by_measurement[:, :3, 3] = by_measurement[:, :3, 1] * disparity[:, None]
            by_measurement[:, 3, 3] = 1.0
        by_nav = np.zeros((n, size, self.observed))
        by_nav[:, :3, POSE] = parametrisation.moved(landmarks[:, :3], imu_T_anchor)
        if self._has_errors:
            self.add_rotation(by_nav, errors, by_nav[..., POSE])
            for name, columns in errors.by_pixel_errors(z, self.rig, self.layout).items():
                by_nav[:, :3, self.layout[name]] = -by_measurement[:, :3, :3] @ columns
        return anchor[None].repeat(n, axis=0), landmarks, by_nav, by_measurement

    def add_rotation(self, by_state: Array, errors: CameraErrors, by_pose: Array) -> None:
        """Fill in the columns of the camera's rotation, if it is in use, from those of the pose.

        Parameters
        ----------
        by_state : (..., d)
            Jacobians, the navigation state first; written to.
        errors : CameraErrors
        by_pose : (..., 6)
            Derivatives with respect to the pose that the camera is at.
        """
        if CAMERA_ROTATION in self.layout:
            by_state[..., self.layout[CAMERA_ROTATION]] = by_pose[..., :3] @ errors.turn


@dataclass(frozen=True)
class View:
    """Landmarks as a camera sees them.

    Attributes
    ----------
    camera : Camera
    errors : CameraErrors
        The shared errors.
    rig : StereoRig
        With them.
    landmarks : (n, 4)
    homogeneous : (n, 4)
        Their points in their anchors.
    cam_T_anchor : (n, 4, 4) or (4, 4)
        Of each landmark, or of all where the anchor is the world.
    in_camera : (n, 4)
        Their points in the left camera, of the same scale.
    """

    camera: Camera
    errors: CameraErrors
    rig: StereoRig
    landmarks: Array
    homogeneous: Array
    cam_T_anchor: Array
    in_camera: Array

    @property
    def depth(self) -> Array:
        """Depth ``(n,)`` in the left camera [m], negative behind it."""
        return np.asarray(self.in_camera[:, 2] / np.maximum(self.in_camera[:, 3], _FARTHEST))

    def measurement(self) -> Array:
        """Measurements (uL, uR, v), ``(n, 3)`` [px]."""
        rig = self.rig
        x, y, z, w = self.in_camera.T
        stretch = 1.0 + self.landmarks[:, 3]
        column = rig.fx * x / z + rig.cx
        out = np.empty((len(z), 3))
        out[:, 0], out[:, 2] = column, rig.fy * y / z + rig.cy
        out[:, 1] = column - (stretch * (rig.fx * rig.baseline) * w / z + self.errors.disparity_offset)
        return out

    def jacobians(self) -> tuple[Array, Array]:
        """H of :meth:`measurement`.

        Returns
        -------
        by_nav : (n, 3, c)
            With respect to the first c components of the navigation state, those that are observed. The pose
            block has minus the circle-dot operator of the point in the body (Barfoot 2017, section 7.1.8);
            the course report's eq. 26 lacks sign and inverse.
        by_landmark : (n, 3, s)
            With respect to the landmark, by the chain rule (course report, eq. 19), and to its
            stereo-matching bias, if it is in the error.
        """
        camera, rig, n = self.camera, self.rig, len(self.in_camera)
        x, y, z, w = self.in_camera.T
        near = 1.0 / z
        by_column, by_row = rig.fx * near, rig.fy * near
        disparity = (rig.fx * rig.baseline) * w * near
        stretch = 1.0 + self.landmarks[:, 3]
        by_camera = np.zeros((n, 3, 4))
        by_camera[:, 0, 0] = by_camera[:, 1, 0] = by_column
        by_camera[:, 0, 2] = by_x_depth = -by_column * x * near
        by_camera[:, 1, 2] = by_x_depth + stretch * disparity * near
        by_camera[:, 1, 3] = stretch * (-rig.baseline * by_column)
        by_camera[:, 2, 1] = by_row
        by_camera[:, 2, 2] = -by_row * y * near
        in_imu = self.in_camera @ rig.imu_T_cam[:3].T
        by_imu = by_camera[:, :, :3] @ rig.cam_T_imu[:3, :3]
        by_nav = np.zeros((n, 3, camera.observed))
        by_nav[:, :, :3] = by_imu @ so3.hat(in_imu)
        by_nav[:, :, 3:6] = by_imu * -w[:, None, None]
        if camera.observed > POSE.stop:
            camera.add_rotation(by_nav, self.errors, by_nav[..., POSE])
            shared = self.errors.by_pixel_errors(self.measurement(), camera.rig, camera.layout)
            for name, columns in shared.items():
                by_nav[:, :, camera.layout[name]] = columns
        by_landmark = by_camera @ (self.cam_T_anchor @ camera.parametrisation.linear)
        if camera.layout.landmark == LANDMARK:
            by_landmark = np.concatenate([by_landmark, np.zeros((n, 3, 1))], axis=2)
            by_landmark[:, 1, 3] = -disparity
        return by_nav, by_landmark

    def drift_cov(self, drift: float) -> Array:
        """Covariance ``(n, 3, 3)`` of a step of ``drift`` [px] in column and row, at constant depth."""
        step = self.drift_step(drift)
        return np.asarray(step @ step.transpose(0, 2, 1))

    def drift_step(self, drift: float) -> Array:
        """Change of the coordinates ``(n, 3, 2)`` by ``drift`` [px] in column and row, at constant depth."""
        rig = self.rig
        lateral = np.swapaxes(self.cam_T_anchor[..., :2, :3], -1, -2) * (
            self.in_camera[:, 2, None, None] * np.array([drift / rig.fx, drift / rig.fy])
        )
        return np.asarray(
            self.camera.parametrisation.coordinates_jacobian(self.homogeneous)[:, :, :3] @ lateral
        )
