"""Samples of an accelerometer and a gyro: the series of a recording, and what lies between two frames."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from vislam.base.arrays import immutable
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.gaps import bridged_densities, held_densities
from vislam.models.imu import ImuNoise
from vislam.models.preintegration import Preintegrated, preintegrate

_GAP = 2.5
"""Samples farther apart than so many usual periods have a gap between them."""
_SAME = 1e-6
"""A sample nearer to a frame's time than this is that of the frame [s]."""


@dataclass(frozen=True)
class ImuSeries:
    """Samples of an inertial measurement unit, on its own clock. Arrays are read-only.

    Attributes
    ----------
    stamp : (n,)
        Increasing, two or more [s].
    gyro : (n, 3)
        Angular velocity, body axes [rad/s].
    accel : (n, 3)
        Specific force, body axes [m/s^2]: when stationary it points up and has the magnitude of gravity.
    duplicates : int
        Samples that were dropped because their stamps were not later than those before.

    Raises
    ------
    ValueError
        If a shape is another, a stamp is not later than the one before, or a number is not finite.
    """

    stamp: Array
    gyro: Array
    accel: Array
    duplicates: int = 0

    def __post_init__(self) -> None:
        """Check, and make the arrays read-only."""
        n = len(self.stamp)
        for name, shape in (("stamp", (n,)), ("gyro", (n, 3)), ("accel", (n, 3))):
            value = np.asarray(getattr(self, name), float)
            if value.shape != shape or n < 2:
                raise ValueError(f"imu {name} must be of shape {shape} with n at least 2, got {value.shape}")
            if not np.isfinite(value).all():
                raise ValueError(f"imu {name} must be free of NaN and infinity")
            object.__setattr__(self, name, immutable(value))
        late = np.flatnonzero(np.diff(self.stamp) <= 0.0)
        if len(late):
            row = int(late[0]) + 1
            raise ValueError(
                f"imu stamp must be increasing [s], got {self.stamp[row]:.9f} after "
                f"{self.stamp[row - 1]:.9f} in row {row}; ImuSeries.of drops and counts such rows"
            )

    @classmethod
    def of(cls, stamp: Array, gyro: Array, accel: Array) -> "ImuSeries":
        """Series of samples as they were read: those that are not later than all before go, and are counted.

        Parameters
        ----------
        stamp : (n,)
            [s].
        gyro, accel : (n, 3)
            [rad/s], [m/s^2].
        """
        stamp = np.asarray(stamp, float)
        latest = np.maximum.accumulate(np.concatenate([[-np.inf], stamp[:-1]]))
        kept = stamp > latest
        return cls(stamp[kept], gyro[kept], accel[kept], duplicates=int(np.count_nonzero(~kept)))

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.stamp)

    @property
    def period(self) -> float:
        """Usual time between samples [s]."""
        return float(np.median(np.diff(self.stamp)))

    @property
    def gaps(self) -> BoolArray:
        """Between which samples and their successors there is a gap, ``(n - 1,)``."""
        return np.asarray(np.diff(self.stamp) > _GAP * self.period)

    @property
    def counts(self) -> dict[str, int]:
        """What was read and dropped, for the counts of a sequence."""
        return {
            "imu_samples": len(self),
            "imu_duplicates": self.duplicates,
            "imu_gaps": int(np.count_nonzero(self.gaps)),
        }

    def at(self, time: Array) -> Array:
        """Gyro and accelerometer ``(m, 6)`` at times ``(m,)`` on its own clock, by straight lines.

        Outside of the series the first or the last sample is held.
        """
        samples = np.hstack([self.gyro, self.accel])
        return np.column_stack([np.interp(time, self.stamp, column) for column in samples.T])

    def steps(self, stamp: Array, *, clock_offset: float = 0.0) -> Iterator["ImuStep"]:
        """What lies between frames, one step a frame; the first has a single sample, and no interval.

        Parameters
        ----------
        stamp : (T,)
            Camera times, increasing [s].
        clock_offset : float
            How late the stamps of the series are against the camera's [s].
        """
        ends = np.asarray(stamp) + clock_offset
        inside = self.stamp[(self.stamp > ends[0]) & (self.stamp < ends[-1])]
        after = np.searchsorted(ends, inside)
        inside = inside[np.minimum(inside - ends[after - 1], ends[after] - inside) > _SAME]
        every = np.sort(np.concatenate([ends, inside]))
        values, times = immutable(self.at(every)), immutable(every - clock_offset)
        middle = 0.5 * (every[1:] + every[:-1])
        place = np.searchsorted(self.stamp, middle) - 1
        between = (place >= 0) & (place < len(self) - 1)
        known = immutable(between & ~self.gaps[np.clip(place, 0, len(self) - 2)])
        missed = immutable(self._missed(place, known, ends) / np.diff(every)[:, None])
        last = np.searchsorted(every, ends)
        for first, end in zip([0, *last[:-1]], last, strict=True):
            rows, inside = slice(first, end + 1), slice(first, end)
            yield ImuStep(times[rows], values[rows, :3], values[rows, 3:], known[inside], missed[inside])

    def _missed(self, place: IntArray, known: BoolArray, ends: Array) -> Array:
        """Squared densities ``(m, 2)`` of what straight lines miss of gyro and accelerometer in intervals.

        Those of the worst axis: 0 where the samples are known, else by the length of the gap.

        Parameters
        ----------
        place : (m,)
            Sample before each interval, -1 before the first.
        known : (m,)
        ends : (T,)
            Frames, on the clock of the series [s].
        """
        out = np.zeros((len(place), 2))
        gap, which = np.unique(place[~known], return_inverse=True)
        if not len(gap):
            return out
        before, after = gap < 0, gap >= len(self) - 1
        inner = np.clip(gap, 0, len(self) - 2)
        length = self.stamp[inner + 1] - self.stamp[inner]
        length[before], length[after] = self.stamp[0] - ends[0], ends[-1] - self.stamp[-1]
        samples = np.hstack([self.gyro, self.accel])
        density = bridged_densities(self.stamp, samples, length)
        held = before | after
        density[held] = held_densities(self.stamp, samples, length[held])
        out[~known] = density.reshape(-1, 2, 3).max(axis=2)[which]
        return out


@dataclass(frozen=True)
class ImuStep:
    """Inertial samples from one frame to the next, with those interpolated at the frames. Read-only.

    Samples are joined by straight lines: over the interval between two of them each stands at their mean.

    Attributes
    ----------
    stamp : (m + 1,)
        On the camera's clock, from the frame before to this one; at the first frame that one alone [s].
    gyro, accel : (m + 1, 3)
        [rad/s], [m/s^2].
    known : (m,)
        Which of the intervals lie between samples of the series; the others are in a gap of it or outside.
    missed : (m, 2)
        Variance of what the straight line misses of the mean rate and of the mean force over each interval
        that is not known (:mod:`vislam.core.gaps`), 0 elsewhere [rad^2/s^2], [m^2/s^4].
    """

    stamp: Array
    gyro: Array
    accel: Array
    known: BoolArray
    missed: Array

    @classmethod
    def joined(cls, steps: Sequence["ImuStep"]) -> "ImuStep":
        """Return the step over several that follow each other."""
        if len(steps) == 1:
            return steps[0]
        parts = [(step.stamp, step.gyro, step.accel) for step in steps]
        # The first sample of a step is the last one of the step before.
        stamp, gyro, accel = (
            np.concatenate([series[0], *(later[1:] for later in series[1:])])
            for series in zip(*parts, strict=True)
        )
        known, missed = (
            np.concatenate([getattr(step, name) for step in steps]) for name in ("known", "missed")
        )
        return cls(*(immutable(part) for part in (stamp, gyro, accel, known, missed)))

    @property
    def dt(self) -> Array:
        """Lengths of the intervals, ``(m,)`` [s]."""
        return np.diff(self.stamp)

    @property
    def mean_gyro(self) -> Array:
        """Mean angular velocity over each interval, ``(m, 3)`` [rad/s]."""
        return np.asarray(0.5 * (self.gyro[1:] + self.gyro[:-1]))

    @property
    def mean_accel(self) -> Array:
        """Mean specific force over each interval, ``(m, 3)`` [m/s^2]."""
        return np.asarray(0.5 * (self.accel[1:] + self.accel[:-1]))

    def preintegrated(self, noise: ImuNoise, gyro_bias: Array, accel_bias: Array) -> Preintegrated:
        """Relative motion over the step, at some biases ``(3,)`` [rad/s], [m/s^2]."""
        return preintegrate(
            self.dt,
            self.mean_gyro,
            self.mean_accel,
            gyro_bias=gyro_bias,
            accel_bias=accel_bias,
            noise=noise,
            unknown=None if self.known.all() else self.missed,
        )

    @property
    def missing(self) -> float:
        """Time of the step that no samples cover [s]."""
        return float(self.dt[~self.known].sum())
