"""Repairs of tracks: a new landmark wherever a track follows another point; no observation is dropped."""

from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT
from vislam.base.types import BoolArray, IntArray
from vislam.core.sequence import Sequence

MOST = 0.5
"""A frame is duplicated when more than this share of the tracks that continue into it repeat their pixels."""
_GRID_PX, _ON_GRID = 0.25, 0.02
"""Pixels are coarse when more than this share of them are multiples of so much; few of fine ones are."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class DuplicatedTracks:
    """Initialise a new landmark wherever a track was re-detected.

    In a duplicated frame the front end writes every surviving track with the pixels of the frame before
    and follows another physical point from there on. The duplicated observation becomes the first of a
    new track; new ids count up from the start of the recording, in order of first observation.
    """

    def apply(self, sequence: Sequence) -> Sequence:
        """Cut the tracks there."""
        duplicated_frame, repeats = duplicated_observations(sequence)
        starts = repeats & duplicated_frame[sequence.frame_of]
        return start_new_tracks(
            sequence,
            starts,
            duplicated_frames=int(duplicated_frame.sum()),
            duplicated_cuts=int(starts.sum()),
            lone_repeats=int(repeats.sum() - starts.sum()),
        )


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Interruptions:
    """Initialise a new landmark where a track was interrupted, so that a lost id is not re-used.

    It does come back where it is one of the landmarks out of view that are remembered, those seen last.
    """

    kept: Annotated[int, Field(ge=0, le=1_000_000)] = 0
    """Landmarks out of view that are remembered; ``data.landmarks`` sets it for estimators, too."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Cut the tracks there."""
        frame, track = sequence.frame_of, sequence.track
        order = np.lexsort((frame, track))
        back = np.zeros(len(track), bool)
        back[order[1:]] = (np.diff(track[order]) == 0) & (np.diff(frame[order]) > 1)
        starts = back & ~_remembered(sequence, back, self.kept) if self.kept else back
        counts = {"interruptions": int(starts.sum())}
        if self.kept:
            counts["seen_again"] = int(back.sum() - starts.sum())
        return start_new_tracks(sequence, starts, **counts)


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Thinning:
    """Keep one track in so many, as is done to save time."""

    every: Annotated[int, Field(ge=1)]
    """Tracks whose id it divides are kept; 1: all."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Drop the others."""
        keep = sequence.track % self.every == 0
        return sequence.select(keep, dropped_thinning=int(np.sum(~keep)))


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SingleObservations:
    """Drop tracks observed once only, which carry no information about motion."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Drop them."""
        keep = sequence.seen_again()
        return sequence.select(keep, dropped_single_observations=int(np.sum(~keep)))


def _remembered(sequence: Sequence, back: BoolArray, kept: int) -> BoolArray:
    """Mask ``(n,)`` of the observations ``back`` whose track is one of the ``kept`` out of view seen last.

    A track that was forgotten once is initialised again, and may be remembered from then on. Of equally late
    ones, the lower ids are kept.
    """
    out = np.zeros(len(back), bool)
    last = np.full(int(sequence.track.max(initial=-1)) + 1, -1)
    for k in range(len(sequence)):
        rows = slice(int(sequence.offset[k]), int(sequence.offset[k + 1]))
        here = sequence.track[rows]
        out[rows] = back[rows] & (last[here] >= 0)
        last[here] = k
        unseen = np.flatnonzero((last >= 0) & (last < k))
        if len(unseen) > kept:
            last[unseen[np.lexsort((unseen, -last[unseen]))][kept:]] = -1
    return out


def duplicated_observations(sequence: Sequence) -> tuple[BoolArray, BoolArray]:
    """Find observations that a re-detecting front end wrote with the pixels of the frame before.

    Where pixels are rounded to a coarse grid, a camera at rest repeats them, too: there a frame is duplicated
    only if most tracks move out of it, or moved into the one before, by more than the grid.

    Returns
    -------
    duplicated_frame : (T,)
        Frames into which most of the continuing tracks repeat their pixels bit for bit.
    repeats : (n,)
        Observations, in any frame, that repeat their predecessor's pixels.
    """
    frame, track = sequence.frame_of, sequence.track
    order = np.lexsort((frame, track))
    same_track = np.diff(track[order]) == 0
    next_frame = np.diff(frame[order]) == 1
    continues, repeats = np.zeros(len(track), bool), np.zeros(len(track), bool)
    continues[order[1:]] = same_track & next_frame
    same_pixels = np.all(np.diff(sequence.pixels[order], axis=0) == 0, axis=1)
    repeats[order[1:]] = same_track & next_frame & same_pixels
    continuing = np.bincount(frame[continues], minlength=len(sequence))
    repeating = np.bincount(frame[repeats], minlength=len(sequence))
    duplicated = (repeating > MOST * continuing) & (continuing > 0)
    if duplicated.any() and np.mean(sequence.pixels % _GRID_PX == 0.0) > _ON_GRID:
        moved = np.zeros(len(track), bool)
        step = np.abs(np.diff(sequence.pixels[order], axis=0)).max(axis=1)
        moved[order[1:]] = same_track & next_frame & (step > 2.0 * _GRID_PX)
        moving = np.bincount(frame[moved], minlength=len(sequence)) > MOST * continuing
        duplicated &= np.append(moving[1:], False) | np.insert(moving[:-1], 0, False)
    return duplicated, repeats


def start_new_tracks(sequence: Sequence, starts: BoolArray, **counts: int) -> Sequence:
    """Let each observation of the mask ``(n,)`` start a new track, adding to the counts."""
    return replace(sequence, track=_renumber(sequence, starts), counts={**sequence.counts, **counts})


def _renumber(sequence: Sequence, starts: BoolArray) -> IntArray:
    """Track ids after each observation of the mask starts a new track, in order of first observation."""
    frame, track = sequence.frame_of, sequence.track
    order = np.lexsort((frame, track))
    new_track = starts[order] | np.diff(track[order], prepend=-1).astype(bool)
    piece = np.empty(len(track), np.int64)
    piece[order] = np.cumsum(new_track) - 1
    _, first, inverse = np.unique(piece, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[inverse]
