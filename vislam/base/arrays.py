"""Arrays that cross a boundary."""

from typing import Any, TypeVar

import numpy as np

Scalar = TypeVar("Scalar", bound=np.generic)


def immutable(array: "np.ndarray[Any, np.dtype[Scalar]]") -> "np.ndarray[Any, np.dtype[Scalar]]":
    """Copy of an array that nobody can make writable again, not by its flags and not through its base."""
    return np.frombuffer(array.tobytes(), dtype=array.dtype).reshape(array.shape)
