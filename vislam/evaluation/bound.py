"""The posterior Cramer-Rao bound of the poses of a simulated sequence.

The information of a graph whose factors are linearised at the truth, with residuals ``r_i = n_i - J_i e`` of
covariance ``R_i``, is ``sum_i J_i^T R_i^-1 J_i``, and no unbiased estimate has a smaller covariance than
its inverse: Tichavsky, Muravchik and Nehorai, *Posterior Cramer-Rao bounds for discrete-time nonlinear
filtering*, IEEE Trans. Signal Processing 46 (1998) 1386-1396. The factors are

* ``z - h(T_k, p_j)``, stereo observations of landmarks of which nothing is known beforehand;
* ``u_k - (log(T_{k-1}^-1 T_k) / dt + b_{k-1})``, the recorded twist of a step;
* ``b_k - b_{k-1}`` and ``b_0 - mean``, the walk of its bias and the prior.

The first pose is known: the bound is of the motion since then, which the errors of a run are of, too.

The elimination of the graph in the order of time is an information filter, whose marginals at each frame are
the bound of filtering, and the backward pass over what was eliminated, as in a junction tree, has the bound
of smoothing. Truth and noise being known, the same passes tell by what the linear estimator that attains the
bound errs on this very noise, so that an excess over the bound can be told from luck.

Nothing here is shared with an estimator: no state, no Jacobian of theirs, no step of their algebra.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.bound import Bound
from vislam.core.record import Tracks
from vislam.geometry import se3, so3
from vislam.models import StereoRig
from vislam.models.odometry import MotionNoise

_POSE, _BIAS, _NAV = slice(0, 6), slice(6, 12), 12
_KNOWN = 1e-9
"""Spread of the first pose, which is known [rad, m]."""
SMALLEST_WALK = 1e-6
"""Walks below this count as this [rad/s/sqrt(s), m/s/sqrt(s)]: with less, a step's information drowns."""


@dataclass(frozen=True)
class BiasPrior:
    """Prior of the twist bias ``(6,)`` [rad/s, m/s]."""

    mean: Array
    sigma: Array


@dataclass(frozen=True)
class TrueDrive:
    """A simulated sequence with its truth.

    Attributes
    ----------
    stamp : (T,)
        [s].
    world_T_imu : (T, 4, 4)
    bias : (T, 6)
        True twist bias, kept through the step that follows [rad/s, m/s].
    step_twist : (T, 6)
        Recorded mean twist of the step that ends at each frame [rad/s, m/s].
    tracks : Tracks
        What was observed, with its noise.
    point : (n, 3)
        The true landmark of each observation [m].
    rig : StereoRig
    """

    stamp: Array
    world_T_imu: Array
    bias: Array
    step_twist: Array
    tracks: Tracks
    point: Array
    rig: StereoRig


def bound(drive: TrueDrive, noise: MotionNoise, prior: BiasPrior) -> Bound:
    """Compute the bound of a sequence with noise of the stated levels."""
    ahead = list(_forward(drive, noise, prior))
    filtered, filtered_error = (np.array(part) for part in zip(*(one.told for one in ahead), strict=True))
    smoothed, smoothed_error = np.empty_like(filtered), np.empty_like(filtered_error)
    cov, mean = ahead[-1].belief.covariance()
    for k in range(len(ahead) - 1, -1, -1):
        one = ahead[k]
        # What was eliminated after the frame is joined again; what it saw first is nobody's before it.
        if one.ended is not None:
            cov, mean = one.ended.joined(cov, mean)
        smoothed[k], smoothed_error[k] = cov[_POSE, _POSE], mean[_POSE]
        before = one.size_before
        if one.stepped is not None:
            cov, mean = one.stepped.joined(cov[:before, :before], mean[:before])
            old = _old_places(before)
            cov, mean = cov[np.ix_(old, old)], mean[old]
    for part in (filtered, smoothed, filtered_error, smoothed_error):
        part[0] = 0.0
    return Bound(filtered, smoothed, filtered_error, smoothed_error)


@dataclass
class _Belief:
    """Information matrix ``(d, d)`` and vector ``(d,)`` of pose, bias and the landmarks that go on."""

    matrix: Array
    vector: Array

    def add(self, jacobian: Array, residual: Array, sigma: Array, *, columns: IntArray) -> None:
        """Add one factor: ``residual (m,) = jacobian (m, c) error + noise`` of ``sigma (m,)``."""
        white = jacobian / sigma[:, None]
        self.matrix[np.ix_(columns, columns)] += white.T @ white
        self.vector[columns] += white.T @ (residual / sigma)

    def covariance(self) -> tuple[Array, Array]:
        """Covariance ``(d, d)`` and error ``(d,)`` of the estimate."""
        factor = cho_factor(self.matrix, lower=True)
        cov = cho_solve(factor, np.eye(len(self.vector)))
        return 0.5 * (cov + cov.T), cho_solve(factor, self.vector)

    def pose(self) -> tuple[Array, Array]:
        """The same of the pose alone."""
        right = np.column_stack([np.eye(len(self.vector))[:, _POSE], self.vector])
        found = cho_solve(cho_factor(self.matrix, lower=True), right)[_POSE]
        return found[:, :6], found[:, 6]

    def without(self, gone: BoolArray) -> "tuple[_Belief, _Eliminated]":
        """Belief of all but some variables, marked in ``(d,)``, and these given the rest."""
        out, kept = np.flatnonzero(gone), np.flatnonzero(~gone)
        mixed = self.matrix[np.ix_(out, kept)]
        solved = cho_solve(
            cho_factor(self.matrix[np.ix_(out, out)], lower=True),
            np.column_stack([mixed, self.vector[out], np.eye(len(out))]),
        )
        n = len(kept)
        gain, mean, cov = solved[:, :n], solved[:, n], solved[:, n + 1 :]
        left = self.matrix[np.ix_(kept, kept)] - mixed.T @ gain
        belief = _Belief(0.5 * (left + left.T), self.vector[kept] - mixed.T @ mean)
        return belief, _Eliminated(out, kept, gain, mean, cov)


@dataclass(frozen=True)
class _Eliminated:
    """Variables given those that stayed: ``mean - gain stayed``, of covariance ``cov``.

    Attributes
    ----------
    out, kept : (a,), (s,)
        Their places in the state before the elimination.
    """

    out: IntArray
    kept: IntArray
    gain: Array
    mean: Array
    cov: Array

    def joined(self, cov: Array, mean: Array) -> tuple[Array, Array]:
        """Covariance and error of all, from those of what stayed."""
        size = len(self.out) + len(self.kept)
        whole, error = np.empty((size, size)), np.empty(size)
        cross = -self.gain @ cov
        whole[np.ix_(self.kept, self.kept)] = cov
        whole[np.ix_(self.out, self.kept)], whole[np.ix_(self.kept, self.out)] = cross, cross.T
        whole[np.ix_(self.out, self.out)] = self.cov - cross @ self.gain.T
        error[self.kept], error[self.out] = mean, self.mean - self.gain @ mean
        return whole, error


@dataclass(frozen=True)
class _Passed:
    """A frame of the forward pass.

    Attributes
    ----------
    told : tuple of (6, 6), (6,)
        Covariance and error of its pose by the data up to it.
    belief : _Belief
        After it, without what is seen no more.
    stepped, ended : _Eliminated or None
        The pose and bias before the step to it, and its landmarks that are seen no more.
    size_before : int
        Size of the state before it saw anything new.
    """

    told: tuple[Array, Array]
    belief: _Belief
    stepped: _Eliminated | None
    ended: _Eliminated | None
    size_before: int


def _forward(drive: TrueDrive, noise: MotionNoise, prior: BiasPrior) -> Iterator[_Passed]:
    tracks = drive.tracks
    # A landmark that is seen once tells nothing.
    _, first, index, views = np.unique(
        tracks.track, return_index=True, return_inverse=True, return_counts=True
    )
    last = np.zeros(len(first), np.int64)
    np.maximum.at(last, index, tracks.frame)
    edges = np.searchsorted(tracks.frame, np.arange(len(drive.stamp) + 1))
    belief, held, stepped = _start(drive, prior), np.empty(0, np.int64), None
    for k in range(len(drive.stamp)):
        if k:
            belief, stepped = _step(belief, drive, noise, k)
        rows = np.arange(edges[k], edges[k + 1])
        rows = rows[views[index[rows]] > 1]
        size_before = len(belief.vector)
        held = np.concatenate([held, np.setdiff1d(index[rows], held)])
        belief = _widened(belief, _NAV + 3 * len(held))
        _see(belief, drive, rows, held=held, track=index[rows], k=k)
        told, ended = belief.pose(), None
        gone = last[held] == k
        if gone.any():
            mask = np.concatenate([np.zeros(_NAV, bool), np.repeat(gone, 3)])
            belief, ended = belief.without(mask)
            held = held[~gone]
        yield _Passed(told, belief, stepped, ended, size_before)


def _start(drive: TrueDrive, prior: BiasPrior) -> _Belief:
    """The first pose, which is known, and the prior of the bias."""
    belief = _Belief(np.zeros((_NAV, _NAV)), np.zeros(_NAV))
    residual = np.concatenate([np.zeros(6), prior.mean - drive.bias[0]])
    sigma = np.concatenate([np.full(6, _KNOWN), np.maximum(prior.sigma, _KNOWN)])
    belief.add(np.eye(_NAV), residual, sigma, columns=np.arange(_NAV))
    return belief


def _step(belief: _Belief, drive: TrueDrive, noise: MotionNoise, k: int) -> tuple[_Belief, _Eliminated]:
    """Belief at frame k in place of that at the frame before, by the recorded twist and the bias' walk."""
    size, dt = len(belief.vector), float(drive.stamp[k] - drive.stamp[k - 1])
    # New pose and bias, landmarks, old pose and bias.
    wide = _Belief(np.zeros((size + _NAV, size + _NAV)), np.zeros(size + _NAV))
    place = _old_places(size)
    wide.matrix[np.ix_(place, place)], wide.vector[place] = belief.matrix, belief.vector
    moved = se3.inverse(drive.world_T_imu[k - 1]) @ drive.world_T_imu[k]
    xi = se3.log(moved)
    by_pose = np.linalg.inv(se3.right_jacobian(xi)) / dt
    jacobian = np.hstack([by_pose, -by_pose @ se3.adjoint(se3.inverse(moved)), np.eye(6)])
    residual = drive.step_twist[k] - xi / dt - drive.bias[k - 1]
    columns = np.concatenate([np.arange(6), np.arange(size, size + _NAV)])
    wide.add(jacobian, residual, noise.twist / np.sqrt(dt), columns=columns)
    walk = np.sqrt(dt) * np.maximum(noise.bias_walk, SMALLEST_WALK)
    columns = np.concatenate([np.arange(6, _NAV), np.arange(size + 6, size + _NAV)])
    change = drive.bias[k - 1] - drive.bias[k]
    wide.add(np.hstack([np.eye(6), -np.eye(6)]), change, walk, columns=columns)
    return wide.without(np.arange(size + _NAV) >= size)


def _old_places(size: int) -> IntArray:
    """Places of the state before a step among new pose and bias, landmarks, and old pose and bias."""
    return np.concatenate([np.arange(size, size + _NAV), np.arange(_NAV, size)])


def _widened(belief: _Belief, size: int) -> _Belief:
    """Belief augmented by landmarks without a prior."""
    old = len(belief.vector)
    matrix = np.zeros((size, size))
    matrix[:old, :old] = belief.matrix
    return _Belief(matrix, np.concatenate([belief.vector, np.zeros(size - old)]))


def _see(
    belief: _Belief, drive: TrueDrive, rows: IntArray, *, held: IntArray, track: IntArray, k: int
) -> None:
    """Add the observations of a frame, all at once."""
    if not len(rows):
        return
    rig, pose, tracks = drive.rig, drive.world_T_imu[k], drive.tracks
    in_imu = se3.transform(se3.inverse(pose), drive.point[rows])
    in_camera = se3.transform(rig.cam_T_imu, in_imu)
    by_imu = rig.projection_jacobian(in_camera) @ rig.cam_T_imu[:3, :3]
    sigma = tracks.sigma[rows]
    white = (tracks.z[rows] - rig.project(in_camera)) / sigma
    by_pose = np.concatenate([by_imu @ so3.hat(in_imu), -by_imu], axis=2) / sigma[:, :, None]
    by_point = by_imu @ pose[:3, :3].T / sigma[:, :, None]
    order = np.argsort(held)
    slot = order[np.searchsorted(held, track, sorter=order)]
    columns = _NAV + 3 * slot[:, None] + np.arange(3)
    belief.matrix[_POSE, _POSE] += np.einsum("nij,nik->jk", by_pose, by_pose)
    belief.vector[_POSE] += np.einsum("nij,ni->j", by_pose, white)
    mixed = by_pose.transpose(0, 2, 1) @ by_point
    belief.matrix[:6, columns.reshape(-1)] += mixed.transpose(1, 0, 2).reshape(6, -1)
    belief.matrix[columns.reshape(-1), :6] += mixed.transpose(0, 2, 1).reshape(-1, 6)
    belief.matrix[columns[:, :, None], columns[:, None, :]] += by_point.transpose(0, 2, 1) @ by_point
    belief.vector[columns] += np.einsum("nij,ni->nj", by_point, white)
