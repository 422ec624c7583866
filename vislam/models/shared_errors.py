"""Calibration errors that all tracks share: by name, with their sizes, and what they make of a stereo rig.

White noise, drift and stereo-matching bias are each track's own and average out over many tracks. What all
tracks share does not, however many there are:

* ``camera_rotation`` psi (3) [rad]: the cameras are turned with the body frame, ``world_T_cam = world_T_imu
  exp(psi^) imu_T_cam``. The lever arm turns, too, by millimetres.
* ``disparity_offset`` o (1) [px]: all disparities are too large by it.
* ``principal_point`` p (2) [px]: all columns, left and right, and all rows are.
* ``focal_scale`` s (1): both focal lengths are ``1 + s`` times what is stated.
* ``clock`` (1) [s]: how much later the inertial stamps are than taken for.
* ``velocity_direction`` (2) [rad]: that of the recorded velocity in the body, to the left and up.

So, with the point ``(x, y, z)`` in the left camera,

    uL = (1 + s) fx x / z + cx + p_u,    v = (1 + s) fy y / z + cy + p_v,
    uL - uR = (1 + s) fx b / z + o.

In a state each is constant or walks randomly. Calibration parameters as unknowns of the same filter: Mirzaei
and Roumeliotis, *A Kalman filter-based algorithm for IMU-camera calibration*, IEEE T-RO 24 (2008).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from vislam.base.types import Array
from vislam.geometry import se3, so3
from vislam.models.stereo import StereoRig

CAMERA_ROTATION = "camera_rotation"
DISPARITY_OFFSET = "disparity_offset"
PRINCIPAL_POINT = "principal_point"
FOCAL_SCALE = "focal_scale"
CLOCK = "clock"
VELOCITY_DIRECTION = "velocity_direction"

SIZES: Mapping[str, int] = {
    CAMERA_ROTATION: 3,
    DISPARITY_OFFSET: 1,
    PRINCIPAL_POINT: 2,
    FOCAL_SCALE: 1,
    CLOCK: 1,
    VELOCITY_DIRECTION: 2,
}
"""All of them, with their sizes."""
UNITS: Mapping[str, str] = {
    CAMERA_ROTATION: "rad",
    DISPARITY_OFFSET: "px",
    PRINCIPAL_POINT: "px",
    FOCAL_SCALE: "",
    CLOCK: "s",
    VELOCITY_DIRECTION: "rad",
}
"""Unit of each; none where it is a share."""
OF_CAMERA = (CAMERA_ROTATION, DISPARITY_OFFSET, PRINCIPAL_POINT, FOCAL_SCALE)
"""Those that the observations depend on."""
OF_PIXELS = OF_CAMERA[1:]
"""Those of them that change pixels, and no pose."""


def prior_name(name: str) -> str:
    """Name of the prior of a shared error in a config's section ``noise``."""
    return f"{name}_sigma{'_px' if UNITS[name] == 'px' else ''}"


@dataclass(frozen=True)
class SharedPrior:
    """What is known beforehand of a shared error, the same of each of its components.

    Attributes
    ----------
    sigma : float
        Prior standard deviation, about 0.
    walk : float
        Density of its random walk [unit/sqrt(s)]; 0: it is constant.
    """

    sigma: float
    walk: float = 0.0


@dataclass(frozen=True)
class CameraErrors:
    """Values of the shared errors that observations depend on.

    Attributes
    ----------
    rotation : (3,)
        psi [rad].
    disparity_offset : float
        o [px].
    principal_point : (2,)
        p [px].
    focal_scale : float
        s.
    """

    rotation: Array = field(default_factory=lambda: np.zeros(3))
    disparity_offset: float = 0.0
    principal_point: Array = field(default_factory=lambda: np.zeros(2))
    focal_scale: float = 0.0

    @classmethod
    def of(cls, values: Mapping[str, Array]) -> Self:
        """Errors from values ``(m,)`` by name; what is not there is zero."""
        none = cls()
        offset, scale = values.get(DISPARITY_OFFSET), values.get(FOCAL_SCALE)
        return cls(
            rotation=np.asarray(values.get(CAMERA_ROTATION, none.rotation)),
            disparity_offset=0.0 if offset is None else float(offset[0]),
            principal_point=np.asarray(values.get(PRINCIPAL_POINT, none.principal_point)),
            focal_scale=0.0 if scale is None else float(scale[0]),
        )

    def values(self) -> dict[str, Array]:
        """Values ``(m,)`` by name."""
        return {
            CAMERA_ROTATION: self.rotation,
            DISPARITY_OFFSET: np.array([self.disparity_offset]),
            PRINCIPAL_POINT: self.principal_point,
            FOCAL_SCALE: np.array([self.focal_scale]),
        }

    @property
    def offset(self) -> Array:
        """What the disparity offset adds to (uL, uR, v), ``(3,)`` [px]."""
        return np.array([0.0, -self.disparity_offset, 0.0])

    @property
    def turn(self) -> Array:
        """Rotation vector ``(3,)`` of the body, to first order, by one of psi: ``J_l(psi)``, ``(3, 3)``.

        ``exp(psi + d) = exp(J_l(psi) d) exp(psi)``: to the camera, a change d of psi is a rotation ``J_l(psi)
        d`` on the right of the body's pose.
        """
        return so3.left_jacobian(self.rotation)

    def rig(self, stated: StereoRig) -> StereoRig:
        """Rig as it is, of one as it is stated; all errors but the disparity offset are in it."""
        mounting = stated.imu_T_cam
        if self.rotation.any():
            turn = se3.from_rotation_translation(so3.exp(self.rotation), np.zeros(3))
            mounting = turn @ mounting
        return replace(
            stated,
            fx=(1.0 + self.focal_scale) * stated.fx,
            fy=(1.0 + self.focal_scale) * stated.fy,
            cx=stated.cx + self.principal_point[0],
            cy=stated.cy + self.principal_point[1],
            imu_T_cam=mounting,
        )

    def mended(self, z: Array, stated: StereoRig) -> Array:
        """Observations ``(..., 3)`` [px] as the stated rig would have made them from the same cameras."""
        centre = np.array([stated.cx, stated.cx, stated.cy])
        shift = self.principal_point[[0, 0, 1]] + self.offset
        return np.asarray((z - shift - centre) / (1.0 + self.focal_scale) + centre)

    def by_pixel_errors(self, z: Array, stated: StereoRig, names: Iterable[str]) -> dict[str, Array]:
        """Derivatives ``(..., 3, m)`` of observations ``z (..., 3)`` [px], predicted with these errors."""
        found: dict[str, Array] = {}
        for name in OF_PIXELS:
            if name not in names:
                continue
            if name == FOCAL_SCALE:
                # What is left of them is in proportion to 1 + s.
                centre = np.array([stated.cx, stated.cx, stated.cy]) + self.principal_point[[0, 0, 1]]
                found[name] = ((z - centre - self.offset) / (1.0 + self.focal_scale))[..., None]
            else:
                found[name] = np.broadcast_to(_CONSTANT[name], (*z.shape, SIZES[name]))
        return found


_CONSTANT = {
    DISPARITY_OFFSET: np.array([[0.0], [-1.0], [0.0]]),
    PRINCIPAL_POINT: np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]),
}
