"""Arrays that cross a boundary."""

from typing import Any, TypeVar

import numpy as np

from vislam.base.types import BoolArray

Scalar = TypeVar("Scalar", bound=np.generic)


def immutable(array: "np.ndarray[Any, np.dtype[Scalar]]") -> "np.ndarray[Any, np.dtype[Scalar]]":
    """Copy of an array that cannot be made writable again, neither by its flags nor through its base."""
    return np.frombuffer(array.tobytes(), dtype=array.dtype).reshape(array.shape)


def runs(mask: BoolArray) -> list[tuple[int, int]]:
    """First and one behind the last index of each run of a mask."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int64)))
    return [(int(first), int(end)) for first, end in edges.reshape(-1, 2)]
