"""Drift as the KITTI odometry benchmark defines it: relative errors over 100 to 800 m, per metre.

Geiger, Lenz and Urtasun, *Are we ready for Autonomous Driving? The KITTI Vision Benchmark Suite* (CVPR 2012),
and ``evaluate_odometry.cpp`` of its development kit: a segment begins at every tenth frame and ends at the
first that is farther along the reference than its length; its error ``(est_i^-1 est_j)^-1 (ref_i^-1 ref_j)``
is divided by that length, however far beyond it the end is; the mean is over all segments of all lengths.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.evaluation.association import Matched

LENGTHS = tuple(range(100, 900, 100))
"""Lengths of the segments [m]."""
_STRIDE = 10
"""Frames from the start of a segment to that of the next."""


@dataclass(frozen=True)
class KittiDrift:
    """Drift of all segments, one entry each.

    Attributes
    ----------
    first, last : (s,)
        Frames between which a segment lies.
    length : (s,)
        One of ``LENGTHS`` [m].
    translation : (s,)
        Translation error over the length.
    rotation : (s,)
        Rotation error over the length [rad/m].
    """

    first: IntArray
    last: IntArray
    length: IntArray
    translation: Array
    rotation: Array

    @property
    def t_rel(self) -> float:
        """Mean translation drift [%]."""
        return float(100.0 * self.translation.mean())

    @property
    def r_rel(self) -> float:
        """Mean rotation drift [deg/100 m]."""
        return float(np.rad2deg(100.0 * self.rotation.mean()))

    def by_length(self) -> dict[int, "KittiDrift"]:
        """The segments of each length [m] of which there are any."""
        return {int(length): self._rows(self.length == length) for length in np.unique(self.length)}

    def _rows(self, rows: Array) -> "KittiDrift":
        return KittiDrift(
            self.first[rows], self.last[rows], self.length[rows], self.translation[rows], self.rotation[rows]
        )


def kitti_drift(matched: Matched) -> KittiDrift | None:
    """Drift over segments of 100 to 800 m.

    Of a match with gaps, only those segments count that would be the same without them: the start is a tenth
    frame from the first matched one, and the frame before the end is matched too, so that no missing one can
    have been the end. The lengths are those of :class:`Matched`. (The kit stores distances and errors in
    single precision, this in double.)

    Returns
    -------
    KittiDrift or None
        None if the reference has no poses, or no segment counts.
    """
    if matched.pose is None or not len(matched.frame):
        return None
    starts = np.flatnonzero((matched.frame - matched.frame[0]) % _STRIDE == 0)
    first, length = (grid.ravel() for grid in np.meshgrid(starts, LENGTHS, indexing="ij"))
    last = np.searchsorted(matched.driven, matched.driven[first] + length, side="right")
    inside = last < len(matched.frame)
    first, last, length = first[inside], last[inside], length[inside]
    sure = matched.frame[last] - matched.frame[last - 1] == 1
    first, last, length = first[sure], last[sure], length[sure]
    if not len(first):
        return None
    error = np.linalg.inv(_motion(matched.estimate, first, last)) @ _motion(matched.pose, first, last)
    # General inverses and the arc cosine, as the kit has them: it matters because the files of references
    # carry seven digits, so that their matrices are not quite rotations.
    cosine = 0.5 * (np.trace(error[:, :3, :3], axis1=1, axis2=2) - 1.0)
    return KittiDrift(
        first=matched.frame[first],
        last=matched.frame[last],
        length=length,
        translation=np.linalg.norm(error[:, :3, 3], axis=1) / length,
        rotation=np.arccos(np.clip(cosine, -1.0, 1.0)) / length,
    )


def _motion(pose: Array, first: IntArray, last: IntArray) -> Array:
    return np.linalg.inv(pose[first]) @ pose[last]
