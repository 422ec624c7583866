"""Relative pose errors over segments of one length or duration, and the segments where they are largest.

A segment begins at each matched frame i. It ends at the later frame j that is nearest to the wanted distance
along the reference (or time) from i, the earlier of two; it counts if it is within a tenth of that.
This is the definition of evo (github.com/MichaelGrupp/evo: RPE over all pairs, pairs from the reference,
relative tolerance 0.1). All estimates of a drive then have the same segments.

The error of a pair is E = (ref_i^-1 ref_j)^-1 (est_i^-1 est_j): Sturm et al., *A Benchmark for the Evaluation
of RGB-D SLAM Systems* (IROS 2012).
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.evaluation.alignment import find_alignment
from vislam.evaluation.association import Matched
from vislam.evaluation.trajectory import Statistics
from vislam.geometry import se3, so3

_TOLERANCE = 0.1
"""How far from the wanted length a segment may be, as a share of it."""


@dataclass(frozen=True)
class RelativeErrors:
    """Errors of motions, one a segment.

    Attributes
    ----------
    first, last : (s,)
        Frames between which a segment lies.
    translation_error : (s,)
        [m].
    rotation_error : (s,) or None
        [rad], 0 to pi; None where displacements were compared, not poses.
    """

    first: IntArray
    last: IntArray
    translation_error: Array
    rotation_error: Array | None

    @property
    def translation(self) -> Statistics | None:
        """Of the translation errors [m]; None if there is no segment."""
        return _statistics(self.translation_error)

    @property
    def rotation(self) -> Statistics | None:
        """Of the rotation errors [rad]; None if there is no segment, or no rotation."""
        return None if self.rotation_error is None else _statistics(self.rotation_error)


@dataclass(frozen=True)
class Segment:
    """A segment and its error.

    Attributes
    ----------
    first, last : int
        Frames between which it lies.
    start : float
        Distance along the reference at which it begins [m].
    error : float
        Translation error [m].
    """

    first: int
    last: int
    start: float
    error: float


def rpe_by_distance(matched: Matched, length_m: float) -> RelativeErrors:
    """Relative pose errors over segments of a length along the reference [m].

    Across gaps of the reference the length is that of the straight line.

    Raises
    ------
    ValueError
        If the reference has no poses; see :func:`displacement_by_distance`.
    """
    return _relative(matched, *_pairs(matched.driven, length_m))


def rpe_by_time(matched: Matched, seconds: float) -> RelativeErrors:
    """Relative pose errors over segments of a duration [s].

    Raises
    ------
    ValueError
        If the reference has no poses; see :func:`displacement_by_time`.
    """
    return _relative(matched, *_pairs(matched.stamp, seconds))


def displacement_by_distance(matched: Matched, length_m: float) -> RelativeErrors:
    """Errors of displacements in the plane over segments of a length along the reference [m].

    ``|(x_j - x_i)_est - (x_j - x_i)_ref|`` of x and y after the planar alignment: what a reference without
    attitudes allows. It is no RPE: an error of the heading at the start of a segment counts in full. Across
    gaps of the reference the length is that of the straight line.
    """
    return _displacement(matched, *_pairs(matched.driven, length_m))


def displacement_by_time(matched: Matched, seconds: float) -> RelativeErrors:
    """Errors of displacements in the plane, as :func:`displacement_by_distance`, over a duration [s]."""
    return _displacement(matched, *_pairs(matched.stamp, seconds))


def worst_segments(matched: Matched, length_m: float, count: int) -> list[Segment]:
    """Segments of a length [m] with the largest translation error, largest first.

    They overlap nowhere: each is the worst of those that lie clear of the ones before it. The error is that
    of :func:`rpe_by_distance`, or of :func:`displacement_by_distance` for a reference without poses.

    Parameters
    ----------
    matched : Matched
    length_m : float
    count : int
        How many at the most.
    """
    measure = displacement_by_distance if matched.pose is None else rpe_by_distance
    errors = measure(matched, length_m)
    found: list[Segment] = []
    for sample in np.argsort(-errors.translation_error, kind="stable"):
        first, last = int(errors.first[sample]), int(errors.last[sample])
        if len(found) == count:
            break
        if all(last <= other.first or other.last <= first for other in found):
            start = matched.driven[np.searchsorted(matched.frame, first)]
            found.append(Segment(first, last, float(start), float(errors.translation_error[sample])))
    return found


def _pairs(along: Array, length: float) -> tuple[IntArray, IntArray]:
    """Rows at which segments begin and end, on a quantity ``along (m,)`` that never falls."""
    if len(along) < 2:
        return np.empty(0, np.int64), np.empty(0, np.int64)
    first = np.arange(len(along) - 1)
    after = np.clip(np.searchsorted(along, along[:-1] + length), first + 1, len(along) - 1)
    before = np.maximum(after - 1, first + 1)
    # Of rows at the same place, where nothing moves, the first.
    before = np.maximum(np.searchsorted(along, along[before]), first + 1)
    short, long = (np.abs(along[row] - along[first] - length) for row in (before, after))
    last = np.where(short <= long, before, after)
    close = np.minimum(short, long) <= _TOLERANCE * length
    return first[close], last[close]


def _relative(matched: Matched, first: IntArray, last: IntArray) -> RelativeErrors:
    if matched.pose is None:
        raise ValueError("relative pose errors must have a reference with poses, got positions alone")
    wanted = se3.inverse(matched.pose[first]) @ matched.pose[last]
    got = se3.inverse(matched.estimate[first]) @ matched.estimate[last]
    error = se3.inverse(wanted) @ got
    return RelativeErrors(
        matched.frame[first],
        matched.frame[last],
        np.linalg.norm(error[:, :3, 3], axis=1),
        np.linalg.norm(so3.log(error[:, :3, :3]), axis=1),
    )


def _displacement(matched: Matched, first: IntArray, last: IntArray) -> RelativeErrors:
    moved = find_alignment("planar", matched).transform_poses(matched.estimate)[:, :2, 3]
    apart = moved - matched.position[:, :2]
    error = np.linalg.norm(apart[last] - apart[first], axis=1)
    return RelativeErrors(matched.frame[first], matched.frame[last], error, None)


def _statistics(values: Array) -> Statistics | None:
    return Statistics.of(values) if len(values) else None
