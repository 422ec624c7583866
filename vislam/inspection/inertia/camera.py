"""The camera's motion by its tracks alone: what raw inertia is held against, so no sample of it enters."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.rigid_fit import FEWEST, Continuations, RigidFit, continuations, fit_frames, step_spread
from vislam.core.sequence import Sequence
from vislam.geometry import se3, so3

_LONGEST_S = 10.0
"""Length of a run: over a longer one the drift of the chained attitude tilts gravity."""
_FEWEST_STEPS = 8
_EXPLAINED = 0.25
"""A rigid motion explains the flow when it leaves less than this share of it."""
_SMALLEST_FLOW_PX = 1.0
_JOINED = 1.5
"""Usual steps."""
_GAP = 1.5
"""A step this many times the usual one has a frame missing."""


@dataclass(frozen=True)
class CameraRun:
    """Successive frames between which the tracks show the motion.

    Attributes
    ----------
    frame : (n + 1,)
        Frames of the sequence.
    stamp : (n + 1,)
        [s].
    pose : (n + 1, 4, 4)
        ``first_T_k`` of the left camera.
    """

    frame: IntArray
    stamp: Array
    pose: Array

    @property
    def joined(self) -> float:
        """Distance of samples up to which a line joins them [s]."""
        return _JOINED * float(np.median(np.diff(self.stamp)))

    def spanning(self, frames: int) -> tuple[Array, Array]:
        """First and last stamp ``(m,)`` of all stretches of so many steps."""
        return self.stamp[:-frames], self.stamp[frames:]

    def rotations(self, time: Array) -> Array:
        """Rotations ``first_R_t (s, 3, 3)`` at times ``(s,)`` of the run, even between frames."""
        k = np.clip(np.searchsorted(self.stamp, time, side="right") - 1, 0, len(self.stamp) - 2)
        before, after = self.pose[k, :3, :3], self.pose[k + 1, :3, :3]
        share = (time - self.stamp[k]) / (self.stamp[k + 1] - self.stamp[k])
        return np.asarray(before @ so3.exp(share[:, None] * so3.log(before.transpose(0, 2, 1) @ after)))


def camera_runs(sequence: Sequence) -> list[CameraRun]:
    """Runs of frames whose motion the tracks show, from fits that begin at standstill.

    Parameters
    ----------
    sequence : Sequence
        With disparities above zero.
    """
    steps = _steps(sequence)
    usual = float(np.median(np.diff(sequence.stamp)))
    runs: list[list[int]] = []
    run: list[int] = []
    begun = 0.0
    for k in range(1, len(sequence)):
        whole = k in steps and sequence.stamp[k] - sequence.stamp[k - 1] <= _GAP * usual
        if run and (not whole or sequence.stamp[k] - begun > _LONGEST_S):
            runs.append(run)
            run = []
        if whole:
            begun = begun if run else sequence.stamp[k - 1]
            run.append(k)
    return [_run(sequence, steps, one) for one in [*runs, run] if len(one) >= _FEWEST_STEPS]


def _run(sequence: Sequence, steps: dict[int, Array], frames: list[int]) -> CameraRun:
    pose = np.empty((len(frames) + 1, 4, 4))
    pose[0] = np.eye(4)
    for at, k in enumerate(frames):
        pose[at + 1] = pose[at] @ se3.inverse(steps[k])
    frame = np.array([frames[0] - 1, *frames])
    return CameraRun(frame, sequence.stamp[frame], pose)


def _steps(sequence: Sequence) -> dict[int, Array]:
    """Motions ``next_T_prev`` by frame, where they explain how the tracks move."""
    pairs, z = continuations(sequence), sequence.z
    frames = np.flatnonzero(np.diff(pairs.start) >= FEWEST)
    fits = fit_frames(
        sequence.rig,
        sequence.rig.back_project(z),
        z,
        pairs=pairs,
        frames=frames,
        spread=step_spread(sequence.disparity),
        guess=np.broadcast_to(np.eye(4), (len(frames), 4, 4)),
    )
    found = {}
    for k, fit in zip(frames.tolist(), fits, strict=True):
        rows = slice(*pairs.start[k : k + 2])
        flow = np.linalg.norm(z[pairs.after[rows]] - z[pairs.before[rows]], axis=1)
        if _explains(fit, float(np.median(flow))):
            found[k] = fit.next_T_prev
    return found


def turns_over(sequence: Sequence, run: CameraRun, frames: int) -> Array:
    """Turns ``prev_R_next (m, 3, 3)`` of a run over stretches of so many steps, each by a fit of its own.

    Tracks that go on over a stretch tell its turn as well as that of one step, and far better than the
    product of its steps. NaN where too few do.
    """
    first, last = run.frame[:-frames], run.frame[frames:]
    chained = se3.inverse(run.pose[frames:]) @ run.pose[:-frames]
    pairs = _apart(sequence, frames)
    enough = np.diff(pairs.start)[last] >= FEWEST
    z = sequence.z
    fits = fit_frames(
        sequence.rig,
        sequence.rig.back_project(z),
        z,
        pairs=pairs,
        frames=last[enough],
        spread=step_spread(sequence.disparity),
        guess=chained[enough],
    )
    out = np.full((len(first), 3, 3), np.nan)
    for at, fit in zip(np.flatnonzero(enough), fits, strict=True):
        out[at] = fit.next_T_prev[:3, :3].T
    return out


def _apart(sequence: Sequence, frames: int) -> Continuations:
    """Pairs of observations of one track so many frames apart."""
    many = len(sequence) + frames
    key = sequence.track * many + sequence.frame_of
    order = np.argsort(key)
    place = np.minimum(np.searchsorted(key[order], key + frames), len(key) - 1)
    before = np.flatnonzero(key[order][place] == key + frames)
    after = order[place[before]]
    by_frame = np.argsort(sequence.frame_of[after], kind="stable")
    before, after = before[by_frame], after[by_frame]
    start = np.searchsorted(sequence.frame_of[after], np.arange(len(sequence) + 1))
    return Continuations(before, after, start)


def _explains(fit: RigidFit, flow: float) -> bool:
    left = float(np.median(np.abs(fit.residual * fit.spread)))
    return bool(np.isfinite(fit.next_T_prev).all()) and left <= _EXPLAINED * max(flow, _SMALLEST_FLOW_PX)
