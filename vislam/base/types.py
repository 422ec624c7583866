"""Names for the arrays that cross module boundaries; shapes are in each docstring."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
"""Real numbers in float64."""
IntArray: TypeAlias = NDArray[np.int64]
"""Indices and ids."""
BoolArray: TypeAlias = NDArray[np.bool_]
"""Masks."""
