"""A trajectory against a reference: every error of it, which metrics sum up and figures show."""

from collections.abc import Mapping
from dataclasses import dataclass

from vislam.base.types import Array, IntArray
from vislam.core.reference import Reference
from vislam.evaluation.alignment import Alignment, AlignmentKind, admitted, find_alignment
from vislam.evaluation.association import Matched, associate
from vislam.evaluation.kitti import KittiDrift, kitti_drift
from vislam.evaluation.rpe import (
    RelativeErrors,
    Segment,
    displacement_by_distance,
    displacement_by_time,
    rpe_by_distance,
    rpe_by_time,
    worst_segments,
)
from vislam.evaluation.trajectory import AbsoluteErrors, ate, final_drift

LENGTHS = (5.0, 10.0, 25.0, 50.0, 100.0, 200.0, 400.0)
"""Lengths of segments for relative errors [m]."""
DURATIONS = (1.0, 5.0, 10.0, 30.0)
"""Durations of them [s]."""
WORST_LENGTH = 50.0
"""Length of the worst segments [m]."""
_WORST = 5
_FEWEST = 3
"""Matched frames without which nothing is said."""


@dataclass(frozen=True)
class TrajectoryScores:
    """A trajectory against a reference.

    Attributes
    ----------
    matched : Matched
    alignments : dict of AlignmentKind to Alignment
        Of each kind that the reference admits.
    absolute : dict of AlignmentKind to AbsoluteErrors
        After each of them.
    by_distance, by_time : dict of float to RelativeErrors
        By the length [m] and the duration [s] of the segments, as far as there are any.
    kitti : KittiDrift or None
    final_drift : float or None
        [%].
    worst : list of Segment
        Of ``WORST_LENGTH``.
    """

    matched: Matched
    alignments: Mapping[AlignmentKind, Alignment]
    absolute: Mapping[AlignmentKind, AbsoluteErrors]
    by_distance: Mapping[float, RelativeErrors]
    by_time: Mapping[float, RelativeErrors]
    kitti: KittiDrift | None
    final_drift: float | None
    worst: list[Segment]

    @property
    def headline(self) -> AbsoluteErrors:
        """Errors after the alignment that the headline is of."""
        return self.absolute[headline_alignment(self.matched.planar)]


def headline_alignment(planar: bool) -> AlignmentKind:
    """Alignment that the headline is of: rigid, in the plane where the reference is planar."""
    return "planar" if planar else "se3"


def score_trajectory(
    frame: IntArray, stamp: Array, world_T_imu: Array, reference: Reference, *, timed: bool = True
) -> TrajectoryScores | None:
    """Score poses ``(T, 4, 4)`` of frames and stamps ``(T,)`` [s]; None if too few have a reference.

    Where the stamps are no times (``timed``), nothing is said over durations.
    """
    matched = associate(frame, stamp, world_T_imu, reference, timed=timed)
    if len(matched.frame) < _FEWEST:
        return None
    of_distance, of_time = rpe_by_distance, rpe_by_time
    if matched.pose is None:
        of_distance, of_time = displacement_by_distance, displacement_by_time
    alignments = {kind: find_alignment(kind, matched) for kind in admitted(matched)}
    return TrajectoryScores(
        matched=matched,
        alignments=alignments,
        absolute={kind: ate(matched, alignment) for kind, alignment in alignments.items()},
        by_distance=_some({length: of_distance(matched, length) for length in LENGTHS}),
        by_time=_some({duration: of_time(matched, duration) for duration in DURATIONS if matched.timed}),
        kitti=kitti_drift(matched),
        final_drift=final_drift(matched),
        worst=worst_segments(matched, WORST_LENGTH, _WORST),
    )


def _some(found: dict[float, RelativeErrors]) -> dict[float, RelativeErrors]:
    return {key: errors for key, errors in found.items() if len(errors.first)}
