"""The accelerometer against the motion of the camera: its axes, its bias and gravity.

Over three frames of a run, the middle one at t, the second divided difference of the positions ``p`` of the
sensor is linear in what the accelerometer has measured, in gravity g and in the bias (all in the axes of the
run's first camera),

    D p = D s(A) - D r c + g,    s(A) = int int R_t A f,    r = int int R_t,    c = A b,

with the attitude ``R_t`` of the camera, and ``A = cam_R_imu``. No velocity enters, and no attitude but that
of the camera within a run.
"""

from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.imu import ImuSeries
from vislam.core.integrals import Integral, covered
from vislam.inspection.inertia.camera import CameraRun

SPAN_S = 0.25
"""From one frame of the three to the next: long enough for the camera's noise, short enough to be local."""
_ITERATIONS = 6


@dataclass(frozen=True)
class Forces:
    """Second divided differences of all runs, ``m`` of them.

    Attributes
    ----------
    seen : (m, 3)
        Of the camera's path [m/s^2].
    by_matrix : (m, 3, 3, 3)
        Derivative of what the accelerometer has measured by A; its last two axes are those of A.
    by_bias : (m, 3, 3)
        By c, its sign turned.
    run : (m,)
        Which run each is of.
    span : float
        From frame to frame of the three [s].
    overlap : int
        How many successive differences have frames in common.
    """

    seen: Array
    by_matrix: Array
    by_bias: Array
    run: IntArray
    span: float
    overlap: int

    @classmethod
    def of(
        cls,
        series: ImuSeries,
        runs: list[CameraRun],
        *,
        lever: Array,
        clock_offset: float,
        span: float = SPAN_S,
    ) -> "Forces":
        """Differences over frames that are ``span`` [s] apart, in whole frames.

        Parameters
        ----------
        series : ImuSeries
        runs : list of CameraRun
        lever : (3,)
            Position of the sensor in the camera [m].
        clock_offset : float
            How late the stamps of the samples are [s].
        span : float
        """
        series = replace(series, stamp=series.stamp - clock_offset)
        parts = [_of_run(series, run, lever=lever, span=span) for run in runs]
        number = np.repeat(np.arange(len(runs)), [len(part[0]) for part in parts])
        empty = (np.zeros((0, 3)), np.zeros((0, 3, 3, 3)), np.zeros((0, 3, 3)), np.zeros(0))
        seen, by_matrix, by_bias, length = (
            np.concatenate([none, *(part[at] for part in parts)]) for at, none in enumerate(empty)
        )
        usual = [float(np.median(np.diff(run.stamp))) for run in runs]
        overlap = 2 * max(round(span / usual[0]), 1) if runs else 1
        return cls(
            seen, by_matrix, by_bias, number, float(np.median(length)) if len(length) else span, overlap
        )

    def __len__(self) -> int:
        """Return their number."""
        return len(self.seen)

    def measured(self, matrix: Array) -> Array:
        """What the accelerometer has measured ``(m, 3)`` with a given A, bias and all [m/s^2]."""
        return np.asarray(np.einsum("mijk,jk->mi", self.by_matrix, matrix))


def _of_run(
    series: ImuSeries, run: CameraRun, *, lever: Array, span: float
) -> tuple[Array, Array, Array, Array]:
    """Seen, by A, by c and spans of a run; none where samples do not cover it."""
    usual = float(np.median(np.diff(run.stamp)))
    many = max(round(span / usual), 1)
    first, middle, last = (run.stamp[at : len(run.stamp) - 2 * many + at] for at in (0, many, 2 * many))
    stamp = series.stamp
    inside = (stamp > run.stamp[0]) & (stamp < run.stamp[-1])
    time = np.unique(np.concatenate([stamp[inside], run.stamp]))
    force = np.column_stack([np.interp(time, stamp, axis) for axis in series.accel.T])
    turn = run.rotations(time)
    path = run.pose[:, :3, 3] + run.pose[:, :3, :3] @ lever
    kept = covered(series, first, last, longest=run.joined)
    values = (
        path,
        Integral(time, np.einsum("sij,sk->sijk", turn, force)).twice(run.stamp),
        Integral(time, turn).twice(run.stamp),
    )
    seen, by_matrix, by_bias = (
        _second_difference(value, first, middle, last, many=many)[kept] for value in values
    )
    return seen, by_matrix, by_bias, (0.5 * (last - first))[kept]


def _second_difference(value: Array, first: Array, middle: Array, last: Array, *, many: int) -> Array:
    """Second divided difference of values at frames, over ``many`` frames to either side."""
    shape = (-1,) + (1,) * (value.ndim - 1)
    earlier, later = (middle - first).reshape(shape), (last - middle).reshape(shape)
    count = len(value) - 2 * many
    before, here, after = (value[at : at + max(count, 0)] for at in (0, many, 2 * many))
    return np.asarray(2.0 * ((after - here) / later - (here - before) / earlier) / (earlier + later))


@dataclass(frozen=True)
class Fall:
    """Gravity and bias for a given A.

    Attributes
    ----------
    gravity : (r, 3)
        Of each run, in the axes of its first camera [m/s^2].
    bias : (3,)
        c: of the accelerometer, in the axes of the camera [m/s^2].
    cov : (3 + 3 r, 3 + 3 r)
        Of bias and gravity.
    residual : (m, 3)
        [m/s^2].
    """

    gravity: Array
    bias: Array
    cov: Array
    residual: Array

    @property
    def magnitude(self) -> tuple[float, float]:
        """Magnitude of gravity over all runs and its standard deviation [m/s^2]."""
        size = np.linalg.norm(self.gravity, axis=1)
        by = np.zeros((len(size), len(self.cov)))
        for k, one in enumerate(self.gravity):
            by[k, 3 + 3 * k : 6 + 3 * k] = one / size[k]
        inverse = np.linalg.inv(by @ self.cov @ by.T)
        return float(inverse.sum(axis=0) @ size / inverse.sum()), float(inverse.sum() ** -0.5)


def fall(forces: Forces, matrix: Array, *, bias_sigma: float) -> Fall:
    """Robust estimate (Geman-McClure weights) of gravity and bias.

    Parameters
    ----------
    forces : Forces
    matrix : (3, 3)
        A.
    bias_sigma : float
        Prior standard deviation of the bias, about 0 [m/s^2].
    """
    runs, where = np.unique(forces.run, return_inverse=True)
    count = len(forces)
    design = np.zeros((count, 3, 3 + 3 * len(runs)))
    design[:, :, :3] = -forces.by_bias
    design[np.arange(count)[:, None], np.arange(3), 3 + 3 * where[:, None] + np.arange(3)] = 1.0
    target = forces.seen - forces.measured(matrix)
    prior = np.zeros(design.shape[2])
    weight = np.ones(count)
    sigma = 1.0
    for _ in range(_ITERATIONS):
        prior[:3] = (sigma / bias_sigma) ** 2
        normal = np.einsum("m,mij,mik->jk", weight, design, design) + np.diag(prior)
        solution = np.linalg.solve(normal, np.einsum("m,mij,mi->j", weight, design, target))
        residual = target - np.einsum("mij,j->mi", design, solution)
        square = np.sum(residual**2, axis=1)
        middle = float(np.median(square)) + 1e-18
        weight = 1.0 / (1.0 + square / (9.0 * middle)) ** 2
        sigma = float(np.sqrt(np.sum(weight * square) / max(3.0 * weight.sum(), 1.0)))
    # Differences that share frames share their errors: information is that of every ``overlap``-th of them.
    normal = normal - np.diag(prior)
    prior[:3] = (sigma / bias_sigma) ** 2
    cov = sigma**2 * np.linalg.inv(normal / forces.overlap + np.diag(prior))
    return Fall(solution[3:].reshape(-1, 3), solution[:3], cov, residual)
