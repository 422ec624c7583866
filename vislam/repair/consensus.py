"""Repair of tracks that follow something else: vehicles, reflections, slipping patches.

They are consistent with themselves, so a gate on single innovations lets them through, and they bend the
estimate. Between two frames the tracks vote on the camera's motion, and a step many deviations off it starts
a new track. A track that never agrees falls to single observations, which say nothing. Where fewer tracks go
on than can decide among themselves, the inertial step votes with them (:mod:`vislam.core.inertial_vote`).

Where ids are those of landmarks, what comes back is the same landmark whatever happened in between. A step
that is off is an observation that is off, then, and no other point: cut there, each of a few landmarks that
are observed again and again would become dozens, and no return would be one.
"""

import numpy as np
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, Positive
from vislam.base.types import Array, BoolArray
from vislam.core.inertial_vote import few_track_distances
from vislam.core.rigid_fit import continuations, rigid_fits
from vislam.core.sequence import Sequence
from vislam.repair.tracks import start_new_tracks


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Consensus:
    """Start a new track at each observation whose step is off the frame's rigid motion."""

    threshold: Positive = 5.0
    """How far off, in robust standard deviations of the frame."""
    recognised: bool = False
    """Whether ids are those of landmarks: an observation whose steps are all off is dropped then, and no
    landmark is split. ``data.landmarks`` sets it for estimators, too."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Cut the tracks there, or drop what is off; duplicated tracks must have been cut before."""
        off = np.nan_to_num(np.linalg.norm(step_residuals(sequence), axis=1)) > self.threshold
        beside_inertia = np.nan_to_num(few_track_distances(sequence)) > self.threshold
        if self.recognised:
            inconsistent = _inconsistent(sequence, off | beside_inertia)
            return sequence.select(~inconsistent, dropped_inconsistent=int(inconsistent.sum()))
        return start_new_tracks(
            sequence,
            off | beside_inertia,
            inconsistent_cuts=int(off.sum()),
            inconsistent_cuts_few_tracks=int(beside_inertia.sum()),
        )


def _inconsistent(sequence: Sequence, off: BoolArray) -> BoolArray:
    """Mask ``(n,)`` of observations that agree with none of their neighbours in successive frames.

    A step does not tell which of its ends is off: one whose other step agrees is not. What has no neighbour
    has nothing to disagree with.

    Parameters
    ----------
    sequence : Sequence
    off : (n,)
        Observations whose step from their predecessor is off.
    """
    pairs = continuations(sequence)
    agrees, neighbour = np.zeros((2, sequence.observations), bool)
    for end in (pairs.before, pairs.after):
        neighbour[end] = True
        agrees[end] |= ~off[pairs.after]
    return neighbour & ~agrees


def step_residuals(sequence: Sequence) -> Array:
    """Residual of each observation against its predecessor under the rigid motion of its frame.

    Returns
    -------
    (n, 3)
        Mean column, disparity and row, in robust standard deviations; NaN without a predecessor
        or where too few tracks vote.
    """
    pairs = continuations(sequence)
    out = np.full((sequence.observations, 3), np.nan)
    for k, fit in rigid_fits(sequence, pairs).items():
        out[pairs.after[pairs.start[k] : pairs.start[k + 1]]] = fit.residual
    return out
