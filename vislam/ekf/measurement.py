"""The stereo measurement of the joint state: value, Jacobians, and the products the update needs."""

from dataclasses import dataclass

import numpy as np

from vislam.ekf.state import JointState
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
    by_point : (n, 3, 3)
        H with respect to the landmark (eq. 19).
    depth : (n,)
        Depth in the left camera [m].
    """

    z: Array
    by_pose: Array
    by_point: Array
    depth: Array


def predict(rig: StereoRig, world_T_imu: Array, points_world: Array) -> Prediction:
    """Measurements of points ``(n, 3)`` [m] and their Jacobians at a pose."""
    rotation = world_T_imu[:3, :3]
    cam_T_imu = rig.cam_T_imu
    points_imu = (points_world - world_T_imu[:3, 3]) @ rotation
    points_cam = se3.transform(cam_T_imu, points_imu)
    by_imu = rig.projection_jacobian(points_cam) @ cam_T_imu[:3, :3]
    return Prediction(
        z=rig.project(points_cam),
        by_pose=np.concatenate([by_imu @ so3.hat(points_imu), -by_imu], axis=2),
        by_point=by_imu @ rotation.T,
        depth=points_cam[:, 2],
    )


def covariances(state: JointState, slots: IntArray, prediction: Prediction) -> tuple[Array, Array]:
    """``P H^T (d, n, 3)`` and ``H P H^T (n, 3, n, 3)`` for landmarks in the given slots.

    H has six dense columns for the pose and one 3x3 block a landmark, so neither product ever
    forms it.
    """
    n, size = len(slots), len(state.cov)
    by_pose = prediction.by_pose.reshape(3 * n, 6)
    blocks = state.cov[:, NAV:].reshape(size, -1, 3)[:, slots].transpose(1, 0, 2)
    cross = (state.cov[:, POSE] @ by_pose.T).reshape(size, n, 3)
    cross += (blocks @ prediction.by_point.transpose(0, 2, 1)).transpose(1, 0, 2)
    flat = cross.reshape(size, 3 * n)
    spread = (by_pose @ flat[POSE]).reshape(n, 3, 3 * n)
    spread += prediction.by_point @ flat[NAV:].reshape(-1, 3, 3 * n)[slots]
    return cross, spread.reshape(n, 3, n, 3)


def initialise(rig: StereoRig, world_T_imu: Array, z: Array) -> tuple[Array, Array, Array]:
    """Landmarks from their first measurement (eq. 20) and their derivatives.

    Returns
    -------
    points_world : (n, 3)
    by_pose : (n, 3, 6)
    by_measurement : (n, 3, 3)
    """
    rotation = world_T_imu[:3, :3]
    points_imu = se3.transform(rig.imu_T_cam, rig.back_project(z))
    turned = np.broadcast_to(rotation, (len(z), 3, 3))
    by_pose = np.concatenate([-turned @ so3.hat(points_imu), turned], axis=2)
    by_measurement = rotation @ rig.imu_T_cam[:3, :3] @ rig.back_projection_jacobian(z)
    return se3.transform(world_T_imu, points_imu), by_pose, by_measurement
