"""Repairs of a recording, each a function from sequence to sequence that counts what it did.

What is wrong with such recordings, and how it was found, is told in the README under "Seven traps".
"""

from dataclasses import replace

import numpy as np

from vislam.data.sequence import Sequence
from vislam.geometry import se3
from vislam.types import Array, BoolArray, IntArray

MOST = 0.5
"""A frame is stale when more than this share of the tracks that continue into it repeat their pixels."""


def turn_body_axes(sequence: Sequence, axes: tuple[str, str, str]) -> Sequence:
    """Express the extrinsic in the velocities' body frame.

    Parameters
    ----------
    sequence : Sequence
    axes : tuple of str
        The body axes of the velocities, written in those of the extrinsic: ``("x", "-y", "-z")``
        says that the velocities are forward-left-up where the extrinsic is forward-right-down.
    """
    turn = se3.from_rotation_translation(axes_rotation(axes), np.zeros(3))
    rig = replace(sequence.rig, imu_T_cam=turn @ sequence.rig.imu_T_cam)
    return replace(sequence, rig=rig)


def axes_rotation(axes: tuple[str, str, str]) -> Array:
    """Rotation ``(3, 3)`` whose rows are the named signed axes; ValueError if it is not proper."""
    rotation = np.zeros((3, 3))
    for row, name in enumerate(axes):
        if name.removeprefix("-") not in ("x", "y", "z"):
            raise ValueError(f"an axis must be x, y, z, -x, -y or -z, got {name!r}")
        rotation[row, "xyz".index(name[-1])] = -1.0 if name.startswith("-") else 1.0
    if not np.isclose(np.linalg.det(rotation), 1.0):
        raise ValueError(f"axes must form a right-handed turn (determinant +1), got {list(axes)}")
    return rotation


def separate_climb_rate(sequence: Sequence) -> Sequence:
    """Take the third velocity component of a levelled recording for what it is, the climb rate.

    The body's own vertical velocity becomes 0: a car does not move along its own z.
    """
    twist = sequence.twist.copy()
    climb_rate = twist[:, 5].copy()
    twist[:, 5] = 0.0
    return replace(sequence, twist=twist, climb_rate=climb_rate)


def stale_observations(sequence: Sequence) -> tuple[BoolArray, BoolArray]:
    """Find observations that a re-detecting front end wrote with the pixels of the frame before.

    Returns
    -------
    stale_frame : (T,)
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
    return (repeating > MOST * continuing) & (continuing > 0), repeats


def cut_stale_tracks(sequence: Sequence) -> Sequence:
    """Start a new landmark wherever a track was re-detected; nothing is thrown away.

    In a stale frame the front end writes every surviving track with the pixels of the frame before
    and follows another physical point from there on. The stale observation becomes the first of a
    new track; new ids count up from the start of the recording, in order of first sight.
    """
    stale_frame, repeats = stale_observations(sequence)
    starts = repeats & stale_frame[sequence.frame_of]
    return start_new_tracks(
        sequence,
        starts,
        stale_frames=int(stale_frame.sum()),
        stale_cuts=int(starts.sum()),
        lone_repeats=int(repeats.sum() - starts.sum()),
    )


def split_interrupted_tracks(sequence: Sequence) -> Sequence:
    """Start a new landmark where a track was out of sight, so that a lost id never comes back."""
    frame, track = sequence.frame_of, sequence.track
    order = np.lexsort((frame, track))
    starts = np.zeros(len(track), bool)
    starts[order[1:]] = (np.diff(track[order]) == 0) & (np.diff(frame[order]) > 1)
    return start_new_tracks(sequence, starts, interruptions=int(starts.sum()))


def start_new_tracks(sequence: Sequence, starts: BoolArray, **counts: int) -> Sequence:
    """Let each observation of the mask ``(n,)`` start a new track, adding to the counts."""
    return replace(sequence, track=_renumber(sequence, starts), counts={**sequence.counts, **counts})


def _renumber(sequence: Sequence, starts: BoolArray) -> IntArray:
    """Track ids after each observation of the mask starts a new track, in order of first sight."""
    frame, track = sequence.frame_of, sequence.track
    order = np.lexsort((frame, track))
    new_track = starts[order] | np.diff(track[order], prepend=-1).astype(bool)
    piece = np.empty(len(track), np.int64)
    piece[order] = np.cumsum(new_track) - 1
    _, first, inverse = np.unique(piece, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[inverse]


def gate_disparity(sequence: Sequence, *, minimum: float, row_difference: float) -> Sequence:
    """Drop what cannot be a stereo observation, and tracks that start too far away to have a depth.

    Parameters
    ----------
    sequence : Sequence
    minimum : float
        Smallest disparity uL - uR at which a track may start [px]. Once started, a track keeps
        every observation of positive disparity, lest the gate pick the noise that makes it near.
    row_difference : float
        Largest |vL - vR| of an observation [px].
    """
    pixels = sequence.pixels
    disparity = pixels[:, 0] - pixels[:, 2]
    rows_differ = np.abs(pixels[:, 1] - pixels[:, 3]) > row_difference
    impossible = ~rows_differ & (disparity <= 0)
    possible = ~rows_differ & ~impossible
    begins = np.where(possible & (disparity >= minimum), sequence.frame_of, len(sequence))
    first = np.full(int(sequence.track.max(initial=-1)) + 1, len(sequence))
    np.minimum.at(first, sequence.track, begins)
    keep = possible & (sequence.frame_of >= first[sequence.track])
    return sequence.select(
        keep,
        dropped_row_difference=int(rows_differ.sum()),
        dropped_disparity_not_positive=int(impossible.sum()),
        dropped_too_far_to_start=int(np.sum(possible & ~keep)),
    )


def drop_single_sightings(sequence: Sequence) -> Sequence:
    """Drop tracks seen once only: they tell nothing about motion."""
    length = np.bincount(sequence.track)
    keep = length[sequence.track] > 1
    return sequence.select(keep, dropped_single_sightings=int(np.sum(~keep)))
