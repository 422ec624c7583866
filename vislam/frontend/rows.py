"""The right camera's rotation by the rows of both images: calibrations are half a pixel off, and more."""

import numpy as np

from vislam.base.types import Array
from vislam.models import StereoRig

_FEWEST = 100
"""Observations below which nothing is said."""
_ITERATIONS = 10
_TUNING = 1.345
"""Of Huber's weights, in robust standard deviations."""
_LARGEST = np.radians(1.0)
"""Rotation above which the calibration is not off, but wrong."""


def row_rotation(rig: StereoRig, pixels: Array) -> Array | None:
    """Rotation vector ``(3,)`` [rad] of the right camera about its x and z axes that makes rows agree.

    A small rotation w takes a ray (x, y, 1) of the right image to the row y - w_x (1 + y^2) + w_z x + w_y x
    y. The turn about y, which is all but an offset of disparity, is not seen in the rows and is left at 0.
    Least squares with Huber's weights.

    Parameters
    ----------
    rig : StereoRig
    pixels : (n, 4)
        Rectified (uL, vL, uR, vR) [px].

    Returns
    -------
    (3,) or None
        None if there are too few observations, or the rotation is no error of a calibration.
    """
    if len(pixels) < _FEWEST:
        return None
    x, y = (pixels[:, 2] - rig.cx) / rig.fx, (pixels[:, 3] - rig.cy) / rig.fy
    design = rig.fy * np.column_stack([-(1.0 + y * y), x])
    wanted = pixels[:, 1] - pixels[:, 3]
    turn: Array = np.zeros(2)
    weight: Array = np.ones(len(pixels))
    for _ in range(_ITERATIONS):
        weighted = design * weight[:, None]
        turn = np.asarray(np.linalg.solve(weighted.T @ design, weighted.T @ wanted), dtype=np.float64)
        residual = np.abs(wanted - design @ turn)
        bound = _TUNING * 1.4826 * max(float(np.median(residual)), 1e-9)
        weight = bound / np.maximum(residual, bound)
    rotation = np.array([turn[0], 0.0, turn[1]])
    return rotation if np.linalg.norm(rotation) < _LARGEST else None
