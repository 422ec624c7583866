"""The vote of a few tracks on a step, in which the inertial step is one more voter.

Six tracks and more decide among themselves what the camera's motion was (:mod:`vislam.core.rigid_fit`); fewer
cannot tell who of them is wrong. The recorded twist can: less what it is off by all along
(:mod:`vislam.core.pooled_fit`), its error x over a step has mean zero and the covariance

    C = A V A^T + diag(density^2) / dt,

V being that of the error all along, A what that makes of this step, and the density the white noise that the
samples themselves show by their fourth differences. With the residuals ``r_i = J_i x + n_i``, n_i of
covariance ``s^2``, each track is held against what the twist and the *other* tracks say of it,

    d_i^2 = (r_i - J_i x_i)^T (J_i P_i J_i^T + s^2)^-1 (r_i - J_i x_i),
    P_i^-1 = C^-1 + sum_{j != i} w_j J_j^T J_j / s^2,

w_j being Geman-McClure weights at the robust mode of all. The scale s is that at which the median of d_i is
that of a chi distribution with three degrees of freedom: whatever else the twist is off by widens it, so that
inertial data which are no good cut nothing.
"""

import numpy as np

from vislam.base import linear
from vislam.base.types import Array, BoolArray
from vislam.core.pooled_fit import InertialPairs, TwistError, inertial_pairs, twist_error
from vislam.core.rigid_fit import FEWEST, robust_scale, robust_weight
from vislam.core.sequence import Sequence

_ITERATIONS, _SCALINGS = 10, 8
_FEWEST_PAIRS = 20
"""With fewer than this the scale stays that of all residuals against the twist, which is no smaller."""
_FOURTH_DIFFERENCE = np.sqrt(70.0)
_SMALLEST = np.array([1e-4, 1e-4, 1e-4, 1e-3, 1e-3, 1e-3])
"""A twist that is told better than this is taken for as good [rad/s, m/s]."""


def few_track_distances(sequence: Sequence) -> Array:
    """Distance ``(n,)`` of each observation from what the twist and the other tracks make of its predecessor.

    In standard deviations, as a norm of three numbers; NaN without a predecessor, where enough tracks vote
    without the twist, and where all pairs of the sequence together do not tell what the twist is off by.
    """
    out = np.full(sequence.observations, np.nan)
    found = inertial_pairs(sequence)
    many = np.diff(found.pairs.start)
    few = (many[found.frame] < FEWEST) if len(found.frame) else np.zeros(0, bool)
    error = twist_error(found) if few.any() else None
    if error is None:
        return out
    dt = np.diff(sequence.stamp, prepend=sequence.stamp[0])
    steps = _Steps(found, few, error, _white(sequence)[None] / np.sqrt(np.maximum(dt, 1e-9))[:, None])
    out[found.pairs.after[few]] = steps.distances()
    return out


def _white(sequence: Sequence) -> Array:
    """White noise ``(6,)`` of the twist by the fourth differences of its samples, as a density."""
    if len(sequence.twist) < _FEWEST_PAIRS:
        return np.zeros(6)
    fourth = np.diff(sequence.twist, n=4, axis=0) / _FOURTH_DIFFERENCE
    period = float(np.median(np.diff(sequence.inertial_stamp)))
    return np.asarray(1.4826 * np.median(np.abs(fourth), axis=0) * np.sqrt(period))


class _Steps:
    """All steps with few tracks, ``F`` of them, each filled up to the most tracks that any has."""

    def __init__(self, found: InertialPairs, few: BoolArray, error: TwistError, white: Array) -> None:
        frame = found.frame[few]
        steps, first, row = np.unique(frame, return_index=True, return_inverse=True)
        self._at = row, np.arange(len(frame)) - first[row]
        self._there = np.zeros((len(steps), FEWEST - 1), bool)
        self._there[self._at] = True
        along = np.zeros((len(steps), 6, 9))
        along[:, :, :6] = np.eye(6)
        along[:, 3:, 6:] = found.forward[few][first][:, None, None] * np.eye(3)
        expected = np.einsum("mri,mi->mr", found.by_error[few], (along @ error.mean)[row])
        self._residual = np.zeros((*self._there.shape, 3))
        self._residual[self._at] = found.residual[few] - expected
        self._jacobian = np.zeros((*self._there.shape, 3, 6))
        self._jacobian[self._at] = found.by_error[few]
        cov = along @ error.cov @ along.transpose(0, 2, 1)
        self._cov = cov + (white[steps] ** 2 + _SMALLEST**2)[:, :, None] * np.eye(6)
        self._prior = linear.inverse(self._cov)
        self._scale = error.scale

    def distances(self) -> Array:
        """Distances ``(m,)`` at the scale that the distances themselves show."""
        scale, distance = self._scale, self._distances(self._scale)
        if len(distance) < _FEWEST_PAIRS:
            return distance
        for _ in range(_SCALINGS):
            scale = min(self._scale, robust_scale((scale * distance) ** 2))
            distance = self._distances(scale)
        return distance

    def _distances(self, scale: float) -> Array:
        residual, jacobian = self._residual / scale, self._jacobian / scale
        eye = np.eye(3)
        beforehand = jacobian @ self._cov[:, None] @ jacobian.transpose(0, 1, 3, 2) + eye
        weight = self._there * robust_weight(_squared(residual, beforehand), 1.0)
        own = jacobian.transpose(0, 1, 3, 2) @ jacobian
        pull = (jacobian.transpose(0, 1, 3, 2) @ residual[..., None])[..., 0]
        for _ in range(_ITERATIONS):
            information = self._prior + np.einsum("fn,fnij->fij", weight, own)
            error = linear.solve(information, np.einsum("fn,fni->fi", weight, pull))
            left = residual - (jacobian @ error[:, None, :, None])[..., 0]
            weight = self._there * robust_weight(np.sum(left**2, axis=2), 1.0)
        information = self._prior + np.einsum("fn,fnij->fij", weight, own)
        others = linear.inverse(information[:, None] - weight[..., None, None] * own)
        pulled = np.einsum("fn,fni->fi", weight, pull)[:, None] - weight[..., None] * pull
        error = (others @ pulled[..., None])[..., 0]
        left = residual - (jacobian @ error[..., None])[..., 0]
        told = jacobian @ others @ jacobian.transpose(0, 1, 3, 2) + eye
        return np.sqrt(_squared(left, told))[self._at]


def _squared(residual: Array, cov: Array) -> Array:
    """Squared Mahalanobis norms of residuals ``(..., 3)``."""
    return np.asarray(np.einsum("...i,...i->...", residual, linear.solve(cov, residual)))
