"""Poses of a reference, and samples, that nobody measured: filled in between two others, in equal steps.

Where an instrument has lost packets, a recording often has what lies between those around the gap, and says
nothing of it. Scored by such poses, an estimator is wrong where it is right.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from vislam.base.arrays import runs
from vislam.base.types import Array, BoolArray
from vislam.core.reference import Reference
from vislam.core.stamped import Stamped

_FEWEST = 4
"""Poses in a row, each in the middle of its neighbours, that are no coincidence."""
_TOLERANCE = 1e-6
"""Of a step: how far from there a pose is that was computed."""
_STEP = 1e3
"""Smallest step, in digits of the file; what moves by a few digits a step may do so equally."""
_DIGITS = 12
_MOST = 0.5
"""Share of the poses beyond which they are of the reference's nature, and no gap."""
_SHOWN = 3
"""Stretches that are named one by one."""


def filled(values: Array, *scales: Array) -> BoolArray:
    """Which rows lie between two others in equal steps, many in a row.

    The rows at both ends of such a stretch were measured, and are not among them. At the beginning and the
    end of a series there is nothing beyond that would confirm them, so there they are.

    Parameters
    ----------
    values : (n, d)
        Positions, or samples.
    *scales : (n,)
        Frames and times of the rows, increasing: steps are equal in one of them.

    Returns
    -------
    (n,)
        Mask.
    """
    out = np.zeros(len(values), bool)
    if len(values) < _FEWEST + 2:
        return out
    for at in scales:
        for first, end in runs(_between_neighbours(values, at)):
            if end - first >= _FEWEST:
                begin, stop = first + 1, end + 1
                out[0 if begin == 1 else begin : len(out) if stop == len(out) - 1 else stop] = True
    return out


def _between_neighbours(values: Array, at: Array) -> BoolArray:
    """Which rows ``(n - 2,)``, the first and the last aside, are what a line between their neighbours has."""
    before, after = values[:-2], values[2:]
    share = ((at[1:-1] - at[:-2]) / (at[2:] - at[:-2]))[:, None]
    length = np.linalg.norm(after - before, axis=1)
    off = np.linalg.norm(before + share * (after - before) - values[1:-1], axis=1)
    return np.asarray((off <= _TOLERANCE * length) & (length > _STEP * _resolution(values)))


def measured(reference: Reference, stamp: Array) -> tuple[Reference, str]:
    """Reference without the poses that were filled in, and a remark on them; empty if there are none.

    Steps are looked at that are equal from frame to frame, and that are equal in time. A reference most of
    whose poses are such was made or interpolated as a whole, and is left as it is.

    Parameters
    ----------
    reference : Reference
    stamp : (T,)
        Camera times of the recording [s].
    """
    frame = reference.frame
    computed = filled(reference.position, frame.astype(float), stamp[frame])
    kept, remark = _judged(reference.name, computed, lambda row: f"{frame[row]}", of="of frames ")
    if kept is None:
        return reference, remark
    return (
        replace(
            reference,
            frame=frame[kept],
            position=reference.position[kept],
            pose=None if reference.pose is None else reference.pose[kept],
        ),
        remark,
    )


def measured_rows(rows: Stamped, name: str) -> tuple[Stamped, str]:
    """The same for a reference that is known by its rows: those that were measured, and a remark.

    Parameters
    ----------
    rows : Stamped
    name : str
        Of the reference, as the remark has it.
    """
    computed = filled(rows.position, np.arange(float(len(rows))), rows.stamp)
    kept, remark = _judged(name, computed, lambda row: f"{rows.stamp[row]:.9g}", of="at stamps ")
    return (rows if kept is None else rows.take(kept)), remark


def _judged(
    name: str, computed: BoolArray, label: Callable[[int], str], *, of: str
) -> tuple[BoolArray | None, str]:
    """Rows of a reference that are kept, None for all, and a remark with the labels of a stretch's ends."""
    if not computed.any():
        return None, ""
    stretches = [f"{label(first)} to {label(end - 1)}" for first, end in runs(computed)]
    shown = ", ".join(stretches[:_SHOWN]) + (" and others" if len(stretches) > _SHOWN else "")
    told = (
        f"{name}: {np.count_nonzero(computed)} of {len(computed)} poses, {of}{shown}, lie between others in "
        "exactly equal steps: "
    )
    if computed.mean() > _MOST:
        return None, f"{told}simulated or interpolated, not measured; they are scored all the same"
    return ~computed, f"{told}filled in, not measured; nothing is scored by them"


def _resolution(values: Array) -> float:
    """Smallest power of ten of which all values are multiples, as a text file has them."""
    for digits in range(_DIGITS):
        if np.abs(np.round(values, digits) - values).max() <= np.spacing(np.abs(values).max()):
            return float(10.0**-digits)
    return 0.0
