"""Where a body with raw inertia stands still, told once from the data for all estimators of a comparison.

Two tests have to pass. **The samples are steady**: over a window, mean rates and forces of the steps spread
about their own mean no more than their noise, a chi-square number of ``6 (N - 1)`` degrees of freedom in
which biases and gravity drop out (the generalised likelihood ratio of Skog, Handel, Nilsson and Rantakokko,
*Zero-velocity detection: an algorithm evaluation*, IEEE TBME 57 (2010), eq. 17, with a free mean). It is the
one that sees a body set off within a step. **The tracks do not move**: a constant velocity and rate of the
camera over such a stretch, fitted to all its observations, is zero by a chi-square test with six degrees of
freedom, and known so well that the slowest motion that matters would have been found. It is the one that
tells standing from an even motion, of which an accelerometer says nothing.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.arrays import immutable, runs
from vislam.base.distributions import chi2_quantile
from vislam.base.types import Array, BoolArray
from vislam.core.rigid_fit import FEWEST, robust_scale, robust_weight
from vislam.core.sequence import Sequence
from vislam.geometry import so3
from vislam.models import StereoRig
from vislam.models.imu import ImuNoise

_PROBABILITY = 0.999
"""With which a body at rest passes each of the tests."""
_WINDOW_S = 1.0
"""Over which samples are compared with each other, and so the shortest standstill."""
_STEADIER = 1.5
"""Windows whose spread is up to this many times the least of the recording are steady, too, if that is more
than the noise: an engine shakes a body that stands."""
_SEPARATION = 5.0
"""Standard deviations between standing still and the slowest motion that is to be told from it."""
_REWEIGHTINGS = 10


@dataclass(frozen=True)
class Standstill:
    """Where a body stands still.

    Attributes
    ----------
    frames : (T,)
        Mask of the frames at which its velocity is zero. Read-only.
    sigma : float
        Standard deviation of that velocity, along each axis [m/s].
    """

    frames: BoolArray
    sigma: float


def standstill(
    sequence: Sequence, noise: ImuNoise, *, pixel_sigma: float, slowest: float, sigma: float
) -> Standstill:
    """Find where a body stands still.

    Parameters
    ----------
    sequence : Sequence
        With raw inertia.
    noise : ImuNoise
    pixel_sigma : float
        White noise of uL and uR [px]; if tracks are noisier, by how much is fitted.
    slowest : float
        A motion at this speed must not be taken for a standstill [m/s].
    sigma : float
        Of the velocity of a body that stands still [m/s].
    """
    frames = np.zeros(len(sequence), bool)
    fit = _Drift.of(sequence, pixel_sigma)
    for first, end in runs(_steady(sequence, noise)):
        # The steps are steady, and so both of their ends are; but for the outermost, which may be moving.
        if fit.still(first - 1, end, slowest):
            frames[first : end - 1] = True
    return Standstill(immutable(frames), sigma)


def _steady(sequence: Sequence, noise: ImuNoise) -> BoolArray:
    """Mask ``(T,)`` of the frames whose step, that ends there, is part of a window of steady samples."""
    assert sequence.imu is not None
    steps = list(sequence.imu.steps(sequence.stamp, clock_offset=sequence.clock_offset))[1:]
    out = np.zeros(len(sequence), bool)
    count = int(np.ceil(_WINDOW_S / np.median(np.diff(sequence.stamp)))) if steps else 0
    if count < 2 or len(steps) < count:
        return out
    length = np.array([step.dt.sum() for step in steps])
    mean = np.array([step.dt @ np.hstack([step.mean_gyro, step.mean_accel]) for step in steps])
    density = np.repeat([noise.gyro_density, noise.accel_density], 3)
    whole = np.array([step.known.all() for step in steps])
    # White noise of a mean over a step; in a window of it the biases walk by next to nothing.
    value = mean / np.sqrt(length)[:, None] / density
    scale = np.sqrt(length)[:, None] / density
    # Weighted by 1 / variance: the mean of a window, and the squares about it, from running sums.
    total = [_windows(part, count) for part in (value**2, value * scale, scale**2)]
    spread = np.sum(total[0] - total[1] ** 2 / total[2], axis=1)
    freedom = 6 * (count - 1)
    known = _windows(whole.astype(float)[:, None], count)[:, 0] > count - 0.5
    if not known.any():
        return out
    least = max(1.0, _STEADIER * float(spread[known].min()) / freedom)
    passes = known & (spread <= least * chi2_quantile(_PROBABILITY, freedom))
    for shift in range(count):
        out[1 + shift : 1 + shift + len(passes)] |= passes
    return out


def _windows(values: Array, count: int) -> Array:
    """Sums ``(n - count + 1, m)`` over windows of rows ``(n, m)``."""
    return np.asarray(np.lib.stride_tricks.sliding_window_view(values, count, axis=0).sum(axis=-1))


@dataclass(frozen=True)
class _Drift:
    """Even motion of the camera over stretches of a sequence, by the slopes of its tracks over time.

    Attributes
    ----------
    sequence : Sequence
    rig : StereoRig
    z : (n, 3)
    time : (n,)
    sigma : (3,)
    """

    sequence: Sequence
    rig: StereoRig
    z: Array
    time: Array
    sigma: Array

    @classmethod
    def of(cls, sequence: Sequence, pixel_sigma: float) -> "_Drift":
        """That of a sequence."""
        sigma = pixel_sigma * np.array([1.0, 1.0, np.sqrt(0.5)])
        return cls(sequence, sequence.rig, sequence.z, sequence.stamp[sequence.frame_of], sigma)

    def still(self, first: int, end: int, slowest: float) -> bool:
        """Whether the camera stands still from a frame to the one before ``end``."""
        rows = slice(self.sequence.offset[first], self.sequence.offset[end])
        _, track = np.unique(self.sequence.track[rows], return_inverse=True)
        z, count = self.z[rows], np.bincount(track)
        many = len(count)
        mean = np.column_stack([np.bincount(track, column, many) for column in z.T]) / count[:, None]
        since = self.time[rows] - (np.bincount(track, self.time[rows], many) / count)[track]
        moment = np.bincount(track, since**2, many)
        slope = np.column_stack([np.bincount(track, since * column, many) for column in z.T])
        # What repeats its pixels bit for bit says nothing of the motion.
        told = (moment > 0.0) & (mean[:, 0] > mean[:, 1]) & np.any(slope != 0.0, axis=1)
        if np.count_nonzero(told) < FEWEST:
            return False
        root = np.sqrt(moment[told])[:, None]
        points = self.rig.back_project(mean[told])
        # A camera that moves by (omega, v) moves the points by the opposite.
        by_point = self.rig.projection_jacobian(points) / self.sigma[:, None]
        jacobian = root[:, :, None] * np.concatenate([by_point @ so3.hat(points), -by_point], axis=2)
        return _zero(jacobian, slope[told] / root / self.sigma, slowest)


def _zero(jacobian: Array, value: Array, slowest: float) -> bool:
    """Whether the motion ``(6,)`` of ``value (n, 3) = jacobian (n, 3, 6) motion`` is zero, and known well."""
    motion, weight = np.zeros(6), np.ones(len(value))
    for _ in range(_REWEIGHTINGS):
        weighted = weight[:, None, None] * jacobian
        information = np.einsum("nij,nik->jk", weighted, jacobian)
        if np.linalg.cond(information) > 1.0 / np.finfo(float).eps:
            return False
        motion = np.linalg.solve(information, np.einsum("nij,ni->j", weighted, value))
        square = np.sum((value - jacobian @ motion) ** 2, axis=1)
        scale = max(1.0, robust_scale(square))
        weight = robust_weight(square, scale)
    known = np.linalg.inv(information)[3:, 3:] * scale**2
    told = _SEPARATION * np.sqrt(np.linalg.eigvalsh(known)[-1]) <= slowest
    return bool(told and motion @ information @ motion <= scale**2 * chi2_quantile(_PROBABILITY, 6))
