"""Poses, or positions, on their own stamps, and what they are between them."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from vislam.base.types import Array, BoolArray, IntArray
from vislam.geometry import se3

_GAP = 3.0
"""Median steps over which it is interpolated; what is farther apart is a gap."""


@dataclass(frozen=True)
class Stamped:
    """A trajectory as it came, on the stamps it came with.

    Attributes
    ----------
    stamp : (n,)
        Increasing [s]; numbers of frames where ``timed`` is false.
    position : (n, 2) or (n, 3)
        [m].
    pose : (n, 4, 4) or None
        Of the same positions; None where there are no attitudes.
    cov : (n, 6, 6) or None
        (omega, v) on the right; NaN where there is none.
    timed : bool
        Whether the stamps are times.
    """

    stamp: Array
    position: Array
    pose: Array | None = None
    cov: Array | None = None
    timed: bool = True

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.stamp)

    @property
    def step(self) -> float:
        """Median step between stamps [s]; 0 of fewer than two."""
        return float(np.median(np.diff(self.stamp))) if len(self) > 1 else 0.0

    @property
    def poses(self) -> Array:
        """Poses ``(n, 4, 4)``, without a turn where there are no attitudes."""
        if self.pose is not None:
            return self.pose
        flat = np.zeros((len(self), 3 - self.position.shape[1]))
        return se3.from_rotation_translation(np.eye(3), np.column_stack([self.position, flat]))

    def take(self, rows: IntArray | BoolArray) -> "Stamped":
        """These rows, by mask or index."""
        names = ("stamp", "position", "pose", "cov")
        found: dict[str, Any] = {
            name: value[rows] for name in names if (value := getattr(self, name)) is not None
        }
        return replace(self, **found)

    def shifted(self, seconds: float) -> "Stamped":
        """The same with this much added to its stamps."""
        return replace(self, stamp=self.stamp + seconds) if seconds else self

    def within(self, at: Array) -> BoolArray:
        """Which of times ``(m,)`` lie on it, and in none of its gaps."""
        if len(self) < 2:
            return np.isin(at, self.stamp)
        after = np.clip(np.searchsorted(self.stamp, at), 1, len(self) - 1)
        inside = (at >= self.stamp[0]) & (at <= self.stamp[-1])
        exact = (at == self.stamp[after]) | (at == self.stamp[after - 1])
        whole = self.stamp[after] - self.stamp[after - 1] <= _GAP * self.step
        return np.asarray(inside & (exact | whole), np.bool_)

    def interpolated(self, at: Array) -> "Stamped":
        """Rows at times ``(m,)`` that are within it.

        Positions and covariances linearly, rotations along the shortest turn at constant rate (Shoemake,
        *Animating Rotation with Quaternion Curves*, SIGGRAPH 1985). At a stamp of its own it is that row.
        """
        after = np.clip(np.searchsorted(self.stamp, at), 1, len(self) - 1)
        before = after - 1
        part = (at - self.stamp[before]) / (self.stamp[after] - self.stamp[before])
        pose = None
        position = _between(self.position, before, after, part)
        if self.pose is not None:
            turn = Slerp(self.stamp, Rotation.from_matrix(self.pose[:, :3, :3]))(at).as_matrix()
            pose = se3.from_rotation_translation(turn, position)
            for row, share in ((before, 0.0), (after, 1.0)):
                own = part == share
                pose[own] = self.pose[row[own]]
        cov = None if self.cov is None else _between(self.cov, before, after, part)
        return Stamped(at, position, pose, cov, self.timed)


def _between(values: Array, before: IntArray, after: IntArray, part: Array) -> Array:
    share = part.reshape(-1, *[1] * (values.ndim - 1))
    # Written so that a share of 0 or 1 gives the row itself, whatever the other is.
    mixed = values[before] + share * (values[after] - values[before])
    return np.where(share == 0.0, values[before], np.where(share == 1.0, values[after], mixed))


def nearest(at: Array, stamp: Array, tolerance: float) -> tuple[IntArray, IntArray]:
    """Rows of ``at`` and of ``stamp`` that belong together, each once: nearest in time, within the tolerance.

    Of several rows of ``at`` that are nearest to the same one of ``stamp``, the closest, the first of equals.

    Parameters
    ----------
    at, stamp : (n,), (m,)
        Increasing [s].
    tolerance : float
        [s].
    """
    if not len(at) or not len(stamp):
        return np.empty(0, np.int64), np.empty(0, np.int64)
    after = np.clip(np.searchsorted(stamp, at), 1, max(len(stamp) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(stamp) - 1)
    other = np.where(at - stamp[before] <= stamp[after] - at, before, after)
    apart = np.abs(at - stamp[other])
    order = np.lexsort((apart, other))
    order = order[apart[order] <= tolerance]
    _, first = np.unique(other[order], return_index=True)
    row = order[first]
    return row, other[row]
