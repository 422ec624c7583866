"""Points of many tracks at once, each from all its views, at given poses.

Gauss-Newton on a point in the world overshoots where the depth is poorly known: for a first depth z0 and
a measured z it lands at ``2 z0 - z0^2 / z``. The same problem in disparity space at the first view is
nearly linear.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.geometry import se3
from vislam.models import StereoRig

_ITERATIONS = 6
_SMALLEST_DISPARITY = 0.5
_SINGULAR = 1e-12
"""Determinant of an information matrix that cannot be told from zero, as a share of that of its diagonal."""


@dataclass(frozen=True)
class Triangulated:
    """Outcome for each track.

    Attributes
    ----------
    mean, cov : (n, 3), (n, 3, 3)
        The point as (uL, uR, v) in the first view, and its covariance [px, px^2].
    residual : (n, V, 3)
        Measured less predicted (uL, uR, v) [px], of all views, those not fitted included. A point behind a
        camera is taken to be as near to it as can be seen, where its disparity is large.
    solved : (n,)
        Whether there is such a point, in front of all views that were fitted. What the other arrays hold
        where there is none has no meaning.
    """

    mean: Array
    cov: Array
    residual: Array
    solved: BoolArray

    @property
    def disparity(self) -> Array:
        """Disparity in the first view, ``(n,)`` [px]."""
        return self.mean[:, 0] - self.mean[:, 1]

    @property
    def disparity_sigma(self) -> Array:
        """Its standard deviation, ``(n,)`` [px]."""
        cov = self.cov
        return np.sqrt(cov[:, 0, 0] + cov[:, 1, 1] - 2.0 * cov[:, 0, 1])


def triangulate(rig: StereoRig, world_T_cam: Array, z: Array, sigma: Array) -> Triangulated:
    """Triangulate tracks by least squares, six steps of Gauss-Newton.

    Parameters
    ----------
    rig : StereoRig
    world_T_cam : (n, V, 4, 4)
        Left camera of each view.
    z : (n, V, 3)
        Measurements (uL, uR, v) [px]; the disparity of the first view must not be zero.
    sigma : (n, V, 3)
        Their standard deviations [px]; infinite where a view is not to be fitted, which the first one is.
    """
    view_T_first = se3.inverse(world_T_cam) @ world_T_cam[:, :1]
    weight = 1.0 / sigma**2
    fitted = np.isfinite(sigma[..., 0])
    mean = z[:, 0].copy()
    solved = np.ones(len(z), bool)
    for _ in range(_ITERATIONS):
        solved &= mean[:, 0] - mean[:, 1] > _SMALLEST_DISPARITY
        mean[~solved] = z[~solved, 0]
        residual, jacobian, depth = _linearise(rig, view_T_first, z, mean)
        solved &= np.all((depth > rig.nearest) | ~fitted, axis=1)
        information = np.einsum("nvia,nvi,nvib->nab", jacobian, weight, jacobian)
        diagonal = np.einsum("naa->na", information)
        solved &= np.linalg.det(information) > _SINGULAR * np.prod(diagonal, axis=1)
        information[~solved] = np.eye(3)
        gradient = np.einsum("nvia,nvi,nvi->na", jacobian, weight, residual)
        step = np.linalg.solve(information, gradient[..., None])[..., 0]
        mean = mean + np.where(solved[:, None], step, 0.0)
    solved &= mean[:, 0] - mean[:, 1] > _SMALLEST_DISPARITY
    mean[~solved] = z[~solved, 0]
    residual, _, depth = _linearise(rig, view_T_first, z, mean)
    solved &= np.all((depth > rig.nearest) | ~fitted, axis=1)
    return Triangulated(mean, np.linalg.inv(information), residual, solved)


def _linearise(rig: StereoRig, view_T_first: Array, z: Array, mean: Array) -> tuple[Array, Array, Array]:
    """Residuals, Jacobians by the disparity-space point, and depths, for every view."""
    moved = se3.transform(view_T_first, rig.back_project(mean)[:, None, None])[:, :, 0]
    depth = moved[..., 2]
    held = np.concatenate([moved[..., :2], np.maximum(depth, rig.nearest)[..., None]], axis=-1)
    by_point = rig.projection_jacobian(held) @ view_T_first[..., :3, :3]
    jacobian = by_point @ rig.back_projection_jacobian(mean)[:, None]
    return z - rig.project(held), jacobian, depth
