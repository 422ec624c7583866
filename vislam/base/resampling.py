"""How uncertain an estimate is by what it becomes without one part of the data."""

import numpy as np

from vislam.base.types import Array


def jackknife(left_out: Array) -> Array:
    """Standard deviation of an estimate from its values with one block left out at a time, ``(b, ...)``.

    It tells how much one part of the drive decides.
    """
    return np.sqrt((len(left_out) - 1) * np.mean((left_out - left_out.mean(axis=0)) ** 2, axis=0))
