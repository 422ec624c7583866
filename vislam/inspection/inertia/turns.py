"""The gyro against the turns of the camera: its unit, its clock, its axes and its bias.

With the rate of the camera over a step, ``y = log(prev_R_next) / dt`` in the camera's axes, and the mean
``x`` of the gyro over the same time,

    y = B x + c,    B = cam_R_imu / unit,    c = -cam_R_imu b,

whatever the mounting and the unit are. So the lag at which a free B leaves the least is that of the clock, B
then has the unit as its scale and the axes as its rotation, and c is the bias.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.resampling import jackknife
from vislam.base.types import Array, BoolArray
from vislam.core.imu import ImuSeries
from vislam.core.integrals import Integral, covered
from vislam.core.sequence import Sequence
from vislam.geometry import so3
from vislam.inspection.finding import Measured
from vislam.inspection.inertia.camera import CameraRun, turns_over
from vislam.inspection.motion import LAGS_S, best_lag

_SPAN_S, _SMALL = 0.3, 0.06
"""A stretch is that long at most, and turns by that much at most, root mean square [s, rad]."""
_ITERATIONS = 6
_BLOCKS = 12
_CLIPPED = 4.0
_DEPTH = 0.2
"""Of the valley of the cost; a car that turns gently has a wide one, whose lowest point is noise."""
_SCALE_FLOOR = 0.005
"""Noise of the points that a step is fitted to makes it shorter by about so much."""
_TOLD = 0.05
"""Standard deviation of a direction of B up to which it is told [rad]."""


@dataclass(frozen=True)
class Turns:
    """Rates of the camera over its steps, and the series that they are held against.

    Attributes
    ----------
    begin, end : (m,)
        Of each step, on the camera's clock [s].
    seen : (m, 3)
        Mean rate of the camera, its own axes [rad/s].
    gyro : Integral
        Of the gyro, on the clock of the samples.
    """

    begin: Array
    end: Array
    seen: Array
    gyro: Integral

    @classmethod
    def of(
        cls, series: ImuSeries, sequence: Sequence, runs: list[CameraRun], *, clock_offset: float
    ) -> "Turns":
        """Stretches around which the samples are complete, at all lags that are tried around an offset [s].

        They are as long as a turn is small over them, so that its logarithm is the mean rate.
        """
        frames = _frames(runs)
        runs = [run for run in runs if len(run.frame) > frames]
        ends = [run.spanning(frames) for run in runs]
        begin = np.concatenate([np.zeros(0), *(one for one, _ in ends)])
        end = np.concatenate([np.zeros(0), *(one for _, one in ends)])
        turns = np.concatenate([np.zeros((0, 3, 3)), *(turns_over(sequence, run, frames) for run in runs)])
        longest = max((run.joined for run in runs), default=0.0)
        around = begin + clock_offset + LAGS_S[0], end + clock_offset + LAGS_S[-1]
        kept = covered(series, *around, longest=longest) & np.isfinite(turns).all(axis=(1, 2))
        begin, end = begin[kept], end[kept]
        seen = so3.log(turns[kept]) / (end - begin)[:, None]
        return cls(begin, end, seen, Integral(series.stamp, series.gyro))

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.begin)

    def measured(self, offset: float) -> Array:
        """Mean ``(m, 3)`` of the gyro over the steps, its stamps late by ``offset`` [s]."""
        whole = self.gyro.once(self.end + offset) - self.gyro.once(self.begin + offset)
        return np.asarray(whole / (self.end - self.begin)[:, None])


def _frames(runs: list[CameraRun]) -> int:
    """Steps of a stretch: one where the camera turns fast."""
    if not runs:
        return 1
    step = float(np.median(np.concatenate([np.diff(run.stamp) for run in runs])))
    turned = np.concatenate(
        [so3.log(run.pose[:-1, :3, :3].transpose(0, 2, 1) @ run.pose[1:, :3, :3]) for run in runs]
    )
    angle = float(np.sqrt(np.mean(np.sum(turned**2, axis=1))))
    return max(int(min(_SPAN_S / step, _SMALL / max(angle, 1e-9))), 1)


@dataclass(frozen=True)
class Fit:
    """Result of the regression.

    Attributes
    ----------
    matrix : (3, 3)
        B: the camera's rate by the gyro's.
    constant : (3,)
        c [rad/s].
    residual : (m, 3)
        [rad/s].
    """

    matrix: Array
    constant: Array
    residual: Array

    @property
    def sigma(self) -> float:
        """Robust standard deviation of the residuals [rad/s]."""
        return float(1.4826 * np.median(np.abs(self.residual)))


def regress(measured: Array, seen: Array) -> Fit:
    """Robust regression (Geman-McClure weights) of rates ``(m, 3)`` on rates ``(m, 3)``."""
    design = np.column_stack([measured, np.ones(len(measured))])
    weight = np.ones(len(measured))
    for _ in range(_ITERATIONS):
        weighted = np.linalg.lstsq(design * weight[:, None], seen * weight[:, None], rcond=None)
        solution = np.asarray(weighted[0], float)
        residual = seen - design @ solution
        square = np.sum(residual**2, axis=1)
        weight = 1.0 / (1.0 + square / (9.0 * np.median(square) + 1e-18))
    return Fit(solution[:3].T, solution[3], residual)


def lag_of(turns: Turns, *, around: float) -> tuple[float, float, Array]:
    """Offset of the stamps of the samples [s], its standard deviation, and the cost of all lags ``(l,)``.

    Parameters
    ----------
    turns : Turns
    around : float
        Offset that the lags are tried around [s].
    """
    residual = np.array([regress(turns.measured(around + lag), turns.seen).residual for lag in LAGS_S])
    spread = np.median(np.abs(residual), axis=1)
    least = 1.4826 * spread[np.argmin(spread.sum(axis=1))] + 1e-9
    cost = np.sum(np.minimum(np.abs(residual) / least, _CLIPPED) ** 2, axis=2)
    lag, sigma = best_lag(cost, depth=_DEPTH)
    return around + lag, sigma, cost.mean(axis=1)


@dataclass(frozen=True)
class Turning:
    """What the steps tell of B.

    Attributes
    ----------
    scale : Measured
        Turns of the gyro over those of the camera.
    axes : (3, d)
        Directions of the gyro's axes whose image is told, of length 1.
    images : (3, d)
        What B, freed of its scale, makes of them.
    correlation : float
        Share of the variance of the camera's rates that the regression explains.
    """

    scale: Measured
    axes: Array
    images: Array
    correlation: float

    @property
    def reflected(self) -> bool:
        """Whether B is no rotation but a reflection, which takes three directions to tell."""
        return self.axes.shape[1] == 3 and bool(np.linalg.det(self.images @ self.axes.T) < 0.0)


def turning(measured: Array, seen: Array) -> Turning:
    """Scale and told directions of B from rates ``(m, 3)`` of gyro and camera at the right lag."""
    fit = regress(measured, seen)
    scale = _scale(fit.matrix, measured)
    parts = [part for part in np.array_split(np.arange(len(seen)), _BLOCKS) if len(part)]
    left_out = []
    for part in parts:
        rest = np.delete(measured, part, axis=0)
        left_out.append(_scale(regress(rest, np.delete(seen, part, axis=0)).matrix, rest))
    sigma = float(np.hypot(jackknife(np.array(left_out)), _SCALE_FLOOR))
    told, axes = _told(measured, fit.sigma * scale)
    explained = 1.0 - float(np.median(np.sum(fit.residual**2, axis=1))) / max(_spread(seen), 1e-18)
    return Turning(
        Measured.around("turns of the gyro over those of the camera", "", scale, sigma=sigma),
        axes[:, told],
        scale * fit.matrix @ axes[:, told],
        explained,
    )


def _spread(rates: Array) -> float:
    return float(np.median(np.sum((rates - np.median(rates, axis=0)) ** 2, axis=1)))


def _scale(matrix: Array, measured: Array) -> float:
    """Turns of the gyro over those that B makes of them: root mean squares."""
    centred = measured - measured.mean(axis=0)
    return float(np.sqrt(np.sum(centred**2) / max(np.sum((centred @ matrix.T) ** 2), 1e-18)))


def _told(measured: Array, sigma: float) -> tuple[BoolArray, Array]:
    """Principal axes ``(3, 3)`` of the rates, and which ``(3,)`` of them turn enough."""
    variance, axes = np.linalg.eigh(np.cov(measured.T))
    error = sigma / np.sqrt(np.maximum(variance, 1e-18) * len(measured))
    return np.asarray(error < _TOLD), axes
