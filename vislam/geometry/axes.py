"""Signed axes, and the rotations that they name."""

import numpy as np

from vislam.base.types import Array


def axes_rotation(axes: tuple[str, str, str]) -> Array:
    """Rotation ``(3, 3)`` whose rows are the named signed axes; ValueError if it is not proper."""
    rotation = np.zeros((3, 3))
    for row, name in enumerate(axes):
        if name.removeprefix("-") not in ("x", "y", "z"):
            raise ValueError(f"an axis must be x, y, z, -x, -y or -z, got {name!r}")
        rotation[row, "xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    if not np.isclose(np.linalg.det(rotation), 1.0):
        raise ValueError(f"axes must form a right-handed turn (determinant +1), got {list(axes)}")
    return rotation
