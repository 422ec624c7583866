"""Stamps in seconds, whatever unit a file has them in."""

import numpy as np

from vislam.base.types import Array
from vislam.datasets.trajectory_formats.options import Unit

_PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9}
_SIZES = ((1e11, "s"), (1e14, "ms"), (1e17, "us"), (np.inf, "ns"))
"""Largest stamps since 1970 of each unit: seconds have ten digits, and three more for each unit."""
_STEPS = ((2e3, "s"), (1e6, "us"), (np.inf, "ns"))
"""Largest median steps of stamps since some other time. Milliseconds cannot be told from seconds by these."""
_LONGEST_STEP = 100.0
"""Median step beyond which a unit by size is not believed [s]."""


def seconds(stamp: Array, unit: Unit, *, named: str = "") -> tuple[Array, tuple[str, ...]]:
    """Stamps ``(n,)`` in seconds, and what is to be said of their unit.

    Parameters
    ----------
    stamp : (n,)
        As the file has them.
    unit : str
        As it was given.
    named : str
        As the file names it; empty if it does not.
    """
    known = stamp[np.isfinite(stamp)]
    if unit != "auto":
        return stamp / _PER_SECOND[unit], ()
    if named in _PER_SECOND:
        return stamp / _PER_SECOND[named], (f"stamps in {named}",) if named != "s" else ()
    if not len(known):
        return stamp, ()
    step = float(np.median(np.abs(np.diff(known)))) if len(known) > 1 else 0.0
    size = float(np.median(np.abs(known)))
    found = next(name for largest, name in _SIZES if size < largest)
    if found == "s" or step / _PER_SECOND[found] > _LONGEST_STEP:
        found = next(name for largest, name in _STEPS if step < largest)
    if found == "s":
        return stamp, ()
    return stamp / _PER_SECOND[found], (f"stamps look like {found}, and are read as such",)
