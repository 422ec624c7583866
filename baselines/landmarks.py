"""Landmarks seen from known poses: an EKF for each (course report, section III-B), all of them at once."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.geometry import se3
from vislam.models import StereoRig
from vislam_baselines.observations import Observations


@dataclass(frozen=True)
class IndependentLandmarks:
    """Landmarks in the world, independent of each other.

    Attributes
    ----------
    track : (m,)
    points_world : (m, 3)
        [m].
    cov : (m, 3, 3)
        [m^2].
    """

    track: IntArray
    points_world: Array
    cov: Array

    @classmethod
    def join(cls, parts: Sequence["IndependentLandmarks"]) -> "IndependentLandmarks":
        """All landmarks of the parts."""
        track, points, cov = zip(*((part.track, part.points_world, part.cov) for part in parts), strict=True)
        return cls(np.concatenate(track), np.concatenate(points), np.concatenate(cov))

    def select(self, which: IntArray | BoolArray) -> "IndependentLandmarks":
        """IndependentLandmarks at places, or of a mask."""
        return IndependentLandmarks(self.track[which], self.points_world[which], self.cov[which])


def initialise(
    rig: StereoRig, world_T_imu: Array, track: IntArray, z: Array, variance: Array
) -> IndependentLandmarks:
    """Landmarks of tracks ``(n,)`` from their first measurements (course report, eq. 20, y from the row).

    Parameters
    ----------
    rig : StereoRig
    world_T_imu : (4, 4)
    track : (n,)
    z, variance : (n, 3)
        (uL, uR, v) [px], disparities above zero, and their variances [px^2].
    """
    world_T_cam = world_T_imu @ rig.imu_T_cam
    by_z = world_T_cam[:3, :3] @ rig.back_projection_jacobian(z)
    return IndependentLandmarks(
        track,
        se3.transform(world_T_cam, rig.back_project(z)),
        (by_z * variance[:, None, :]) @ by_z.transpose(0, 2, 1),
    )


def update(
    landmarks: IndependentLandmarks, seen: Observations, z: Array, variance: Array
) -> tuple[IndependentLandmarks, float, float]:
    """Kalman update of each landmark by its own measurement, in Joseph's form (Barfoot 2017, section 4.2.3).

    Parameters
    ----------
    landmarks : IndependentLandmarks
    seen : Observations
        As predicted.
    z, variance : (m, 3)
        As measured [px], and the variances [px^2].

    Returns
    -------
    IndependentLandmarks
    float, float
        Normalised innovation squared, and the logarithm of the density of the innovations.
    """
    jacobian, innovation = seen.by_point, z - seen.z
    noise = variance[:, :, None] * np.eye(3)
    projected = jacobian @ landmarks.cov
    spread = projected @ jacobian.transpose(0, 2, 1) + noise
    gain = np.linalg.solve(spread, projected).transpose(0, 2, 1)
    kept = np.eye(3) - gain @ jacobian
    cov = kept @ landmarks.cov @ kept.transpose(0, 2, 1) + gain @ noise @ gain.transpose(0, 2, 1)
    points = landmarks.points_world + (gain @ innovation[:, :, None])[:, :, 0]
    nis = float(np.sum(innovation * np.linalg.solve(spread, innovation[:, :, None])[:, :, 0]))
    log_det = float(np.linalg.slogdet(spread)[1].sum()) + innovation.size * float(np.log(2.0 * np.pi))
    return replace(landmarks, points_world=points, cov=cov), nis, -0.5 * (nis + log_det)
