"""The stereo measurement of the joint state: value, Jacobians, and the products the update needs.

A landmark is (x, y, z, e): its point in the world [m], and the share e by which its disparity is too large
because the right patch follows another point than the left one.
"""

from dataclasses import dataclass

import numpy as np

from vislam.ekf.state import LANDMARK, JointState
from vislam.geometry import se3, so3
from vislam.motion import NAV, POSE
from vislam.sensors import StereoRig
from vislam.types import Array, IntArray


@dataclass(frozen=True)
class Prediction:
    """Predicted stereo measurements of landmarks in the state.

    Attributes
    ----------
    z : (n, 3)
        Predicted (uL, uR, v) [px].
    by_pose : (n, 3, 6)
        H with respect to the pose error: minus the derivative that the report's eq. (26) has, whose sign
        and inverse are wrong.
    by_landmark : (n, 3, 4)
        H with respect to the landmark (eq. 19) and to the error of its match.
    depth : (n,)
        Depth in the left camera [m].
    """

    z: Array
    by_pose: Array
    by_landmark: Array
    depth: Array


def predict(rig: StereoRig, world_T_imu: Array, landmarks: Array) -> Prediction:
    """Measurements of landmarks ``(n, 4)`` and their Jacobians at a pose."""
    rotation = world_T_imu[:3, :3]
    cam_T_imu = rig.cam_T_imu
    points_imu = (landmarks[:, :3] - world_T_imu[:3, 3]) @ rotation
    points_cam = se3.transform(cam_T_imu, points_imu)
    match = landmarks[:, 3]
    z = rig.project(points_cam)
    disparity = z[:, 0] - z[:, 1]
    z[:, 1] -= match * disparity
    by_cam = rig.projection_jacobian(points_cam)
    by_cam[:, 1] -= match[:, None] * (by_cam[:, 0] - by_cam[:, 1])
    by_imu = by_cam @ cam_T_imu[:3, :3]
    by_landmark = np.zeros((len(z), 3, LANDMARK))
    by_landmark[:, :, :3] = by_imu @ rotation.T
    by_landmark[:, 1, 3] = -disparity
    return Prediction(
        z=z,
        by_pose=np.concatenate([by_imu @ so3.hat(points_imu), -by_imu], axis=2),
        by_landmark=by_landmark,
        depth=points_cam[:, 2],
    )


def covariances(state: JointState, slots: IntArray, prediction: Prediction) -> tuple[Array, Array]:
    """``P H^T (d, n, 3)`` and ``H P H^T (n, 3, n, 3)`` for landmarks in the given slots.

    H has six dense columns for the pose and one block a landmark, so neither product ever
    forms it.
    """
    n, size = len(slots), len(state.cov)
    by_pose = prediction.by_pose.reshape(3 * n, 6)
    blocks = state.cov[:, NAV:].reshape(size, -1, LANDMARK)[:, slots].transpose(1, 0, 2)
    cross = (state.cov[:, POSE] @ by_pose.T).reshape(size, n, 3)
    cross += (blocks @ prediction.by_landmark.transpose(0, 2, 1)).transpose(1, 0, 2)
    flat = cross.reshape(size, 3 * n)
    spread = (by_pose @ flat[POSE]).reshape(n, 3, 3 * n)
    spread += prediction.by_landmark @ flat[NAV:].reshape(-1, LANDMARK, 3 * n)[slots]
    return cross, spread.reshape(n, 3, n, 3)


def initialise(rig: StereoRig, world_T_imu: Array, z: Array) -> tuple[Array, Array, Array]:
    """Landmarks from their first measurement (eq. 20), the error of the match taken as 0.

    Returns
    -------
    landmarks : (n, 4)
    by_pose : (n, 4, 6)
        Derivative with respect to the pose error.
    by_measurement : (n, 4, 4)
        Derivative with respect to (uL, uR, v) and to the error of the match.
    """
    n, rotation = len(z), world_T_imu[:3, :3]
    points_imu = se3.transform(rig.imu_T_cam, rig.back_project(z))
    turned = np.broadcast_to(rotation, (n, 3, 3))
    by_pose = np.zeros((n, LANDMARK, 6))
    by_pose[:, :3] = np.concatenate([-turned @ so3.hat(points_imu), turned], axis=2)
    by_measurement = np.zeros((n, LANDMARK, 4))
    by_pixels = rotation @ rig.imu_T_cam[:3, :3] @ rig.back_projection_jacobian(z)
    by_measurement[:, :3, :3] = by_pixels
    # The right pixel of the point itself is uR + e (uL - uR).
    by_measurement[:, :3, 3] = by_pixels[:, :, 1] * (z[:, 0] - z[:, 1])[:, None]
    by_measurement[:, 3, 3] = 1.0
    landmarks = np.column_stack([se3.transform(world_T_imu, points_imu), np.zeros(n)])
    return landmarks, by_pose, by_measurement


def drift_cov(rig: StereoRig, world_T_imu: Array, points_world: Array, *, drift: float) -> Array:
    """Covariance ``(n, 3, 3)`` [m^2] of the step of points whose column and row drift by ``drift`` [px]."""
    rotation = world_T_imu[:3, :3] @ rig.imu_T_cam[:3, :3]
    points_cam = se3.transform(se3.inverse(world_T_imu @ rig.imu_T_cam), points_world)
    per_pixel = np.zeros((len(points_cam), 3, 2))
    per_pixel[:, 0, 0] = points_cam[:, 2] / rig.fx
    per_pixel[:, 1, 1] = points_cam[:, 2] / rig.fy
    turned = drift * rotation @ per_pixel
    return np.asarray(turned @ turned.transpose(0, 2, 1))
