"""A stereo visual-inertial recording in memory: immutable, in SI units, observations kept sparse."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from itertools import islice, repeat
from typing import Any

import numpy as np

from vislam.base.arrays import immutable
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.frame import Frame, OdometryStep, StereoFrame
from vislam.core.imu import ImuSeries
from vislam.models import StereoRig
from vislam.models.imu import ImuPrior

_STEP_END = 1e-7
"""How far the samples of a step with constant twist lie inside its ends, as a share of its length."""


@dataclass(frozen=True)
class Repair:
    """What became of one repair step.

    Attributes
    ----------
    name : str
        As in the config.
    applied : bool
        Whether it was switched on.
    options : dict
    counts : dict of str to int
        What it cut or dropped.
    before, after : int
        Observations that it was given and that it left.
    """

    name: str
    applied: bool
    options: dict[str, Any]
    counts: dict[str, int]
    before: int = 0
    after: int = 0


@dataclass(frozen=True)
class Sequence:
    """A recording, or a repaired one. Arrays are read-only.

    Observations lie frame after frame; those of frame k are ``offset[k]:offset[k + 1]``.

    Attributes
    ----------
    name : str
    stamp : (T,)
        Camera times, increasing [s].
    inertial_stamp : (S,)
        Times of the inertial samples, increasing [s].
    twist : (S, 6)
        Inertial samples (omega, v), body frame [rad/s, m/s].
    vertical_velocity : (S,)
        Vertical velocity samples [m/s], NaN where the velocity is not levelled.
    rig : StereoRig
    offset : (T + 1,)
    track : (n,)
        Track id of each observation.
    pixels : (n, 4)
        uL, vL, uR, vR [px].
    row : (n,)
        Which observation of the unrepaired recording each one is.
    clock_offset : float
        How late the inertial stamps are against the camera's [s].
    synthetic : bool
        True if the sequence was simulated in place of, or without, a recording.
    digest : str
        Hash of the data.
    counts : dict
        What was read, cut and dropped.
    repairs : tuple of Repair
        The steps that made the sequence from the recording, in order.
    imu : ImuSeries or None
        Samples of accelerometer and gyro, on the clock of ``inertial_stamp``; None where there are none.
    start : ImuPrior or None
        What is known of the state at the first frame, if the recording says so, as a simulation does; None
        where it is to be found from the data.
    keyframe : (T,) or None
        Which frames have observations that are given; None: all do.
    """

    name: str
    stamp: Array
    inertial_stamp: Array
    twist: Array
    vertical_velocity: Array
    rig: StereoRig
    offset: IntArray
    track: IntArray
    pixels: Array
    row: IntArray
    clock_offset: float = 0.0
    synthetic: bool = False
    digest: str = ""
    counts: dict[str, int] = field(default_factory=dict)
    repairs: tuple[Repair, ...] = ()
    imu: ImuSeries | None = None
    start: ImuPrior | None = None
    keyframe: BoolArray | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self.stamp)

    @property
    def observations(self) -> int:
        """Number of stereo observations."""
        return len(self.track)

    @property
    def frame_of(self) -> IntArray:
        """Frame index of each observation, ``(n,)``."""
        return np.repeat(np.arange(len(self)), np.diff(self.offset))

    @property
    def z(self) -> Array:
        """Stereo measurements (uL, uR, v), ``(n, 3)`` [px]."""
        return stereo_triples(self.pixels)

    @property
    def disparity(self) -> Array:
        """Disparities uL - uR, ``(n,)`` [px]."""
        return self.pixels[:, 0] - self.pixels[:, 2]

    def select(self, keep: BoolArray, **counts: int) -> "Sequence":
        """Return the sequence with the observations of the mask ``(n,)`` only, adding to the counts."""
        lengths = np.bincount(self.frame_of[keep], minlength=len(self))
        return replace(
            self,
            offset=np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
            track=self.track[keep],
            pixels=self.pixels[keep],
            row=self.row[keep],
            counts={**self.counts, **counts},
        )

    def first(self, frames: int) -> "Sequence":
        """Return the sequence of the first frames only, of all if these are fewer."""
        return self.part(0, frames)

    def part(self, begin: int, end: int) -> "Sequence":
        """Return the sequence of the frames from ``begin`` to before ``end`` only, as far as there are.

        What is known of the state at the first frame goes, unless it is the first of the part, too.
        """
        end = min(end, len(self))
        rows = slice(int(self.offset[begin]), int(self.offset[end]))
        return replace(
            self,
            stamp=self.stamp[begin:end],
            offset=self.offset[begin : end + 1] - self.offset[begin],
            track=self.track[rows],
            pixels=self.pixels[rows],
            row=self.row[rows],
            keyframe=None if self.keyframe is None else self.keyframe[begin:end],
            start=self.start if begin == 0 else None,
        )

    def with_keyframes(self, every: int) -> "Sequence":
        """Return the sequence whose frames between keyframes have no observations.

        Keyframes are the first frame and every ``every``-th from there.
        """
        keyframe = np.arange(len(self)) % every == 0
        kept = keyframe[self.frame_of]
        return replace(
            self.select(
                kept,
                keyframes=int(np.count_nonzero(keyframe)),
                dropped_between_keyframes=int(np.count_nonzero(~kept)),
            ),
            keyframe=keyframe,
        )

    def at_keyframes(self) -> "Sequence":
        """Return the sequence of the keyframes alone, which follow each other; itself if all frames are."""
        if self.keyframe is None:
            return self
        rows = np.flatnonzero(self.keyframe)
        return replace(
            self, stamp=self.stamp[rows], offset=self.offset[np.append(rows, len(self))], keyframe=None
        )

    def mask_of(self, frame: IntArray, track: IntArray) -> BoolArray:
        """Mask ``(n,)`` of the observations with these frame indices and track ids, ``(m,)`` in any order.

        Raises
        ------
        ValueError
            If the sequence lacks one of them.
        """
        many = max(self.track.max(initial=0), np.max(track, initial=0)) + 1
        wanted = np.unique(frame * many + track)
        found = np.isin(self.frame_of * many + self.track, wanted)
        if np.count_nonzero(found) != len(wanted):
            missing = len(wanted) - np.count_nonzero(found)
            raise ValueError(
                f"{missing} of {len(wanted)} pairs of frame and track are no observations of {self.name}"
            )
        return found

    def age(self) -> IntArray:
        """Frames for which the track of each observation was followed, ``(n,)``; while it is away, none."""
        frame = self.frame_of
        order = np.lexsort((frame, self.track))
        fresh = np.diff(self.track[order], prepend=-1) != 0
        step = np.diff(frame[order], prepend=0)
        # A track that comes back goes on where it was; within a life of its own each frame counts.
        total = np.cumsum(np.where(fresh | (step > 1), np.where(fresh, 0, 1), step))
        age = np.empty_like(total)
        start = np.maximum.accumulate(np.where(fresh, np.arange(len(total)), 0))
        age[order] = total - total[start]
        return age

    def seen_again(self, among: BoolArray | None = None) -> BoolArray:
        """Mask ``(n,)`` of the observations whose track has more than one, among those of a mask ``(n,)``."""
        _, track = np.unique(self.track, return_inverse=True)
        return np.asarray(np.bincount(track, weights=among)[track] > 1)

    def first_rows(self) -> IntArray:
        """Row of the first observation of each observation's track, ``(n,)``."""
        _, first, track = np.unique(self.track, return_index=True, return_inverse=True)
        return np.asarray(first[track])

    def frames(
        self, sigma: Array, usable: BoolArray | None = None, *, begin: int = 0, end: int | None = None
    ) -> Iterator[Frame]:
        """Frames in order; their arrays cannot be made writable, as the next estimator is given them too.

        Parameters
        ----------
        sigma : (n, 3)
            Standard deviations of the observations [px].
        usable : (n,), optional
            Which of the observations may be fused; all if left out.
        begin, end : int
            Frames from ``begin`` to before ``end`` only; to the last for None.
        """
        z, sigma, track = immutable(self.z), immutable(sigma), immutable(self.track)
        usable = immutable(np.ones(self.observations, bool) if usable is None else usable)
        means, rise = self.step_means()
        twist = immutable(means)
        at = self.stamp + self.clock_offset
        at_frame = np.column_stack([np.interp(at, self.inertial_stamp, axis) for axis in self.twist.T])
        change = immutable(np.diff(at_frame, axis=0, prepend=at_frame[:1]))
        dt = np.diff(self.stamp, prepend=self.stamp[0])
        imu = repeat(None) if self.imu is None else self.imu.steps(self.stamp, clock_offset=self.clock_offset)
        every = range(len(self) if end is None else min(end, len(self)))
        for k, inertia in islice(zip(every, imu, strict=False), begin, None):
            rows = slice(self.offset[k], self.offset[k + 1])
            yield Frame(
                k=k,
                stamp=float(self.stamp[k]),
                dt=float(dt[k]),
                stereo=StereoFrame(track[rows], z[rows], sigma[rows], usable[rows]),
                odometry=OdometryStep(twist[k], change[k], float(rise[k])),
                imu=inertia,
                keyframe=self.keyframe is None or k == 0 or bool(self.keyframe[k]),
            )

    def step_means(self) -> tuple[Array, Array]:
        """Mean twist ``(T, 6)`` and vertical velocity ``(T,)`` over the step that ends at each frame.

        The samples are joined by straight lines, moved by the clock offset and averaged exactly
        over the step. The first row, which ends no step, is the value at the first frame.
        """
        samples = np.column_stack([self.twist, self.vertical_velocity])
        means = np.empty((len(self), samples.shape[1]))
        at = self.stamp + self.clock_offset
        for column in range(samples.shape[1]):
            means[0, column] = np.interp(at[0], self.inertial_stamp, samples[:, column])
            integral = _integrate_linear(self.inertial_stamp, samples[:, column], at)
            means[1:, column] = np.diff(integral) / np.diff(self.stamp)
        return means[:, :6], means[:, 6]


def stereo_triples(pixels: Array) -> Array:
    """(uL, uR, v) of pixels (uL, vL, uR, vR), ``(n, 4)`` to ``(n, 3)`` [px]."""
    return np.column_stack([pixels[:, 0], pixels[:, 2], 0.5 * (pixels[:, 1] + pixels[:, 3])])


def piecewise_constant(stamp: Array, step_twist: Array) -> tuple[Array, Array]:
    """Inertial samples whose mean over each step is the step's own twist, which they keep all through it.

    A sequence joins its samples by straight lines, so a step has two equal ones just inside its ends; what
    lies between two steps is too short to be felt.

    Parameters
    ----------
    stamp : (T,)
        Camera times, increasing from about 0 [s].
    step_twist : (T - 1, 6)
        Twist from each frame to the next [rad/s, m/s].

    Returns
    -------
    inertial_stamp : (2 (T - 1),)
    twist : (2 (T - 1), 6)
    """
    inside = _STEP_END * np.diff(stamp)
    ends = np.column_stack([stamp[:-1] + inside, stamp[1:] - inside])
    return ends.reshape(-1), np.repeat(step_twist, 2, axis=0)


def _integrate_linear(stamp: Array, value: Array, at: Array) -> Array:
    """Integral from ``stamp[0]`` to each time of ``at`` of the samples joined by straight lines.

    Outside the samples the first or last value is held.
    """
    step = np.diff(stamp)
    total = np.concatenate([[0.0], np.cumsum(0.5 * (value[1:] + value[:-1]) * step)])
    inside = np.clip(at, stamp[0], stamp[-1])
    left = np.clip(np.searchsorted(stamp, inside, side="right") - 1, 0, len(stamp) - 2)
    since = inside - stamp[left]
    slope = (value[left + 1] - value[left]) / step[left]
    partial = total[left] + value[left] * since + 0.5 * slope * since**2
    before, after = np.minimum(at - stamp[0], 0.0), np.maximum(at - stamp[-1], 0.0)
    return np.asarray(partial + before * value[0] + after * value[-1])
