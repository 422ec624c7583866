"""Batch solution of stereo tracks alone: all poses and landmarks at once, by Levenberg-Marquardt."""

import gtsam
import numpy as np

from vislam.base.types import Array
from vislam.core.sequence import Sequence
from vislam.geometry import se3
from vislam.models import TrackNoise

_HUBER = 1.345
_PIXEL_SIGMA = 1.0
_RELATIVE_TOLERANCE = 1e-4
"""Where the iterations end; going on moves no pose of KITTI 00 by more than 0.1 mm."""


def batch_poses(sequence: Sequence, world_T_imu: Array) -> Array:
    """Poses ``(T, 4, 4)`` of the body that fit the tracks best; the inertial data has no part in them.

    The first pose is held. A Huber kernel bounds what a wrong observation can do; no track is left out.

    Parameters
    ----------
    sequence : Sequence
        With positive disparities.
    world_T_imu : (T, 4, 4)
        Where to start from; landmarks start where their first observation puts them.
    """
    rig = sequence.rig
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    calibration = gtsam.Cal3_S2Stereo(rig.fx, rig.fy, 0.0, rig.cx, rig.cy, rig.baseline)
    mounting = gtsam.Pose3(rig.imu_T_cam)
    sigmas = TrackNoise(_PIXEL_SIGMA, 0.0, 0.0).sigma
    noise = gtsam.noiseModel.Robust.Create(
        gtsam.noiseModel.mEstimator.Huber.Create(_HUBER), gtsam.noiseModel.Diagonal.Sigmas(sigmas)
    )
    poses = [gtsam.symbol("x", k) for k in range(len(sequence))]
    for key, pose in zip(poses, world_T_imu, strict=True):
        values.insert(key, gtsam.Pose3(pose))
    for track, point in _first_observations(sequence, world_T_imu):
        values.insert(gtsam.symbol("l", track), point)
    graph.push_back(gtsam.NonlinearEqualityPose3(poses[0], values.atPose3(poses[0])))
    for frame, track, z in zip(sequence.frame_of, sequence.track, sequence.z, strict=True):
        landmark = gtsam.symbol("l", int(track))
        measured = gtsam.StereoPoint2(*z)
        graph.push_back(
            gtsam.GenericStereoFactor3D(measured, noise, poses[frame], landmark, calibration, mounting)
        )
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(_RELATIVE_TOLERANCE)
    solved = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
    return np.array([solved.atPose3(key).matrix() for key in poses])


def _first_observations(sequence: Sequence, world_T_imu: Array) -> list[tuple[int, Array]]:
    """Tracks, and the points ``(3,)`` [m] that their first observations put them at."""
    track, first = np.unique(sequence.track, return_index=True)
    points = sequence.rig.back_project(sequence.z[first])
    world_T_cam = world_T_imu[sequence.frame_of[first]] @ sequence.rig.imu_T_cam
    placed = se3.transform(world_T_cam, points[:, None])[:, 0]
    return list(zip(track.tolist(), placed, strict=True))
