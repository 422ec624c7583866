"""Which poses of an estimate belong to which rows of a reference."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.reference import Reference


@dataclass(frozen=True)
class Matched:
    """An estimate and a reference on the frames that both have, at the reference's point.

    Attributes
    ----------
    frame : (m,)
        Increasing; it may have gaps.
    stamp : (m,)
        Camera times [s].
    estimate : (m, 4, 4)
        Estimated poses of the reference's point, in the estimate's world.
    position : (m, 2) or (m, 3)
        Positions of the reference [m]; two columns if it is planar.
    pose : (m, 4, 4) or None
        Poses of the reference.
    driven : (m,)
        Distance along the reference from its first row [m]. It counts all rows of the reference, those
        without a partner as well, and joins them by straight lines: across a gap of the reference it is the
        shortest way there can be, not the way driven.
    estimate_dropped, reference_dropped : int
        Frames that have no partner.
    timed : bool
        Whether the stamps are times; numbers of frames otherwise.
    """

    frame: IntArray
    stamp: Array
    estimate: Array
    position: Array
    pose: Array | None
    driven: Array
    estimate_dropped: int
    reference_dropped: int
    timed: bool = True

    @property
    def planar(self) -> bool:
        """Whether the reference has no height."""
        return self.position.shape[1] == 2


def associate(
    frame: IntArray, stamp: Array, world_T_imu: Array, reference: Reference, *, timed: bool = True
) -> Matched:
    """Match an estimate with a reference by frame, and move it to the reference's point.

    Parameters
    ----------
    frame : (T,)
        Frames that the estimate has, increasing, with or without gaps.
    stamp : (T,)
        Their camera times [s].
    world_T_imu : (T, 4, 4)
    reference : Reference
    timed : bool
        Whether the stamps are times.

    Returns
    -------
    Matched
        With no rows if there is no common frame.
    """
    common, own, other = np.intersect1d(frame, reference.frame, return_indices=True)
    return Matched(
        frame=common,
        stamp=stamp[own],
        estimate=world_T_imu[own] @ reference.imu_T_point,
        position=reference.position[other],
        pose=None if reference.pose is None else reference.pose[other],
        driven=distance_along(reference.position)[other],
        estimate_dropped=len(frame) - len(common),
        reference_dropped=len(reference.frame) - len(common),
        timed=timed,
    )


def distance_along(position: Array) -> Array:
    """Distance ``(n,)`` [m] along the straight lines that join positions ``(n, d)``, n at least 1."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(position, axis=0), axis=1))])
