"""Where a landmark starts: all its views so far triangulated at once, for many landmarks together.

Gauss-Newton on a point in the world overshoots where the depth is poorly known: for a first depth z0 and
a measured z it lands at ``2 z0 - z0^2 / z``. The same problem in disparity space at the first view is
nearly linear. A track starts when its disparity stands clear of its uncertainty, and waits until then.
"""

from dataclasses import dataclass

import numpy as np

from vislam.geometry import se3
from vislam.sensors import StereoRig
from vislam.types import Array, BoolArray

_ITERATIONS = 6
_NEAREST = 1.0
_SMALLEST_DISPARITY = 0.5
_SINGULAR = 1e-12
"""Determinant of an information matrix that cannot be told from zero, as a share of that of its diagonal."""
_WORST_RESIDUAL = 4.0
"""A track with a residual beyond this many standard deviations is not one static point."""


@dataclass(frozen=True)
class Start:
    """Outcome for each track.

    Attributes
    ----------
    points_world : (n, 3)
    depth : (n,)
        Depth in its first view [m].
    ready : (n,)
        Whether it may start.
    """

    points_world: Array
    depth: Array
    ready: BoolArray


def triangulate(rig: StereoRig, world_T_imu: Array, z: Array, sigma: Array, *, clear: float) -> Start:
    """Triangulate tracks from all their views.

    Parameters
    ----------
    rig : StereoRig
    world_T_imu : (n, V, 4, 4)
        Pose of each view; the first view of a track comes first.
    z : (n, V, 3)
        Measurements (uL, uR, v) [px].
    sigma : (n, V, 3)
        Their standard deviations [px]; infinite where a track has no such view.
    clear : float
        How many standard deviations the disparity must be away from zero.
    """
    world_T_cam = world_T_imu @ rig.imu_T_cam
    view_T_first = se3.inverse(world_T_cam) @ world_T_cam[:, :1]
    weight = 1.0 / sigma**2
    seen = np.isfinite(sigma[..., 0])
    mean = z[:, 0].copy()
    ready = np.ones(len(z), bool)
    for _ in range(_ITERATIONS):
        ready &= mean[:, 0] - mean[:, 1] > _SMALLEST_DISPARITY
        mean[~ready] = z[~ready, 0]
        residual, jacobian, depth = _linearise(rig, view_T_first, z, mean)
        ready &= np.all((depth > _NEAREST) | ~seen, axis=1)
        information = np.einsum("nvia,nvi,nvib->nab", jacobian, weight, jacobian)
        ready &= np.linalg.det(information) > _SINGULAR * np.prod(np.einsum("naa->na", information), axis=1)
        information[~ready] = np.eye(3)
        gradient = np.einsum("nvia,nvi,nvi->na", jacobian, weight, residual)
        step = np.linalg.solve(information, gradient[..., None])[..., 0]
        mean = mean + np.where(ready[:, None], step, 0.0)
    ready &= mean[:, 0] - mean[:, 1] > _SMALLEST_DISPARITY
    mean[~ready] = z[~ready, 0]
    residual, _, depth = _linearise(rig, view_T_first, z, mean)
    cov = np.linalg.inv(information)
    spread = np.sqrt(cov[:, 0, 0] + cov[:, 1, 1] - 2.0 * cov[:, 0, 1])
    ready &= mean[:, 0] - mean[:, 1] > clear * spread
    ready &= np.all(np.abs(residual) * np.sqrt(weight) < _WORST_RESIDUAL, axis=(1, 2))
    ready &= np.all((depth > _NEAREST) | ~seen, axis=1)
    points_cam = rig.back_project(np.where(ready[:, None], mean, [1.0, 0.0, 0.0]))
    points_world = se3.transform(world_T_cam[:, 0], points_cam[:, None])[:, 0]
    return Start(points_world, points_cam[:, 2], ready)


def _linearise(rig: StereoRig, view_T_first: Array, z: Array, mean: Array) -> tuple[Array, Array, Array]:
    """Residuals, Jacobians by the disparity-space point, and depths, for every view."""
    moved = se3.transform(view_T_first, rig.back_project(mean)[:, None, None])[:, :, 0]
    depth = moved[..., 2]
    held = np.concatenate([moved[..., :2], np.maximum(depth, _NEAREST)[..., None]], axis=-1)
    by_point = rig.projection_jacobian(held) @ view_T_first[..., :3, :3]
    jacobian = by_point @ rig.back_projection_jacobian(mean)[:, None]
    return z - rig.project(held), jacobian, depth
