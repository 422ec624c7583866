"""Parametrisations of a landmark: the meaning of its three numbers.

A landmark is the homogeneous point ``X = (x, y, z, w)`` in an anchor frame, the Euclidean point
``(x, y, z) / w``. Its parameters q are affine in X with one component of X held at 1:

* ``point``: X = (q, 1), the Euclidean point. The anchor is the world.
* ``anchored_uvd``: X = ((q0 - cx) / fx, (q1 - cy) / fy, 1, q2 / (fx b)): column u, row v and disparity d in
the
  camera of the first observation, which is the anchor. Stereo errors are near Gaussian in them, and a point
  at infinity (q2 = 0) is regular. Montiel, Civera, Davison, *Unified inverse depth parametrization for
  monocular SLAM* (RSS 2006), for a stereo pair.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from vislam.base.types import Array
from vislam.geometry import so3
from vislam.models import StereoRig

ParametrisationName = Literal["point", "anchored_uvd"]

_W = 3
"""The last component of a homogeneous point."""
_FARTHEST = 1e-4
"""Smallest w for which a point is returned: 10 km where z is 1 [1/m]."""


@dataclass(frozen=True)
class Parametrisation:
    """An affine map from parameters to homogeneous points.

    Attributes
    ----------
    linear : (4, 3)
    constant : (4,)
    one : int
        The component of X that is always 1.
    anchored : bool
        Whether the anchor is the first camera; the world if not.
    """

    linear: Array
    constant: Array
    one: int
    anchored: bool

    def homogeneous(self, q: Array) -> Array:
        """Homogeneous points ``(n, 4)`` of coordinates ``(n, 3)``."""
        return q @ self.linear.T + self.constant

    def coordinates(self, homogeneous: Array) -> Array:
        """ParametrisationName ``(n, 3)`` of homogeneous points ``(n, 4)`` of any scale."""
        scaled = homogeneous / homogeneous[:, self.one, None]
        return (scaled - self.constant) @ self._inverse.T

    def coordinates_jacobian(self, homogeneous: Array) -> Array:
        """Derivative ``(n, 3, 4)`` of :meth:`coordinates`."""
        scale = homogeneous[:, self.one, None, None]
        out = self._inverse / scale
        out[:, :, self.one] -= (homogeneous @ self._inverse.T) / scale[:, :, 0] ** 2
        return out

    def moved(self, q: Array, body_T_anchor: Array) -> Array:
        """Derivative ``(..., n, 3, 6)`` of the coordinates by a motion (omega, v) of the world.

        A motion ``exp(xi)`` of the points, told in the frame of a body, moves the point p in that frame by
        ``omega x p + w v``, w being its last homogeneous coordinate: ``dp = (-hat(p), w 1) xi``.

        Parameters
        ----------
        q : (..., n, 3)
        body_T_anchor : (4, 4) or (n, 4, 4)
        """
        homogeneous = self.homogeneous(q)
        # Of X by the motion, and of the coordinates by X with the component that is 1 held; w moves nothing.
        in_body = (body_T_anchor[..., :3, :] @ homogeneous[..., None])[..., 0]
        turned = np.swapaxes(body_T_anchor[..., :3, :3], -1, -2)
        by_body = self._inverse[:, :3] @ turned
        if self.one < _W:
            off = homogeneous @ self._inverse.T
            by_body = by_body - off[..., None] * turned[..., None, self.one, :]
        out = np.empty((*q.shape, 6))
        np.matmul(by_body, so3.hat(-in_body), out=out[..., :3])
        np.multiply(by_body, homogeneous[..., _W, None, None], out=out[..., 3:])
        return out

    def points(self, q: Array) -> tuple[Array, Array]:
        """Euclidean points ``(n, 3)`` [m] in the anchor, and their derivatives ``(n, 3, 3)``."""
        homogeneous = self.homogeneous(q)
        w = np.maximum(homogeneous[:, 3], _FARTHEST)
        points = homogeneous[:, :3] / w[:, None]
        jacobian = self.linear[:3] - points[:, :, None] * self.linear[3]
        return points, jacobian / w[:, None, None]

    @cached_property
    def _inverse(self) -> Array:
        return np.asarray(np.linalg.pinv(self.linear), dtype=np.float64)


def make(kind: ParametrisationName, rig: StereoRig) -> Parametrisation:
    """Parametrisation of a name for a rig."""
    if kind == "point":
        return Parametrisation(np.eye(4, 3), np.array([0.0, 0.0, 0.0, 1.0]), one=3, anchored=False)
    linear = np.zeros((4, 3))
    linear[0, 0], linear[1, 1], linear[3, 2] = 1.0 / rig.fx, 1.0 / rig.fy, 1.0 / (rig.fx * rig.baseline)
    constant = np.array([-rig.cx / rig.fx, -rig.cy / rig.fy, 1.0, 0.0])
    return Parametrisation(linear, constant, one=2, anchored=True)
