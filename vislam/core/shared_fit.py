"""One pooled fit of what all tracks share to the residuals of a whole recording.

With the twist bias b (6) of the recording, a white error of the twist in each step and the noise of the
tracks, the residuals of :mod:`vislam.core.shared_residuals` are

    r = D theta + B (b + w_k) + v,   w_k ~ N(0, diag(density^2) / dt),   v ~ N(0, I / weight).

The steps' errors w_k are integrated out frame by frame (a Schur complement), so that a step whose twist is
noisy says only what its own tracks say among themselves: with the density at 0 the recorded motion is
believed, without bounds it is that of the tracks alone. What is left are normal equations of a frame each,
whose sums over blocks of the recording are all that estimates, shares and intervals take. The intervals are
those of a block bootstrap (Kuensch 1989): residuals are correlated in time.
"""

from collections.abc import Sequence as Items
from dataclasses import dataclass

import numpy as np

from vislam.base import linear
from vislam.base.types import Array, IntArray
from vislam.core.rigid_fit import robust_weight
from vislam.core.shared_residuals import SharedResiduals

_BLOCKS, _DRAWS, _SEED = 20, 200, 0
_RIDGE = 1e-9
_BIAS = 6
_REWEIGHTINGS, _RESTS = 10, 1e-3


@dataclass(frozen=True)
class Fitted:
    """Estimate of some parameters.

    Attributes
    ----------
    value, sigma : (q,)
        And standard deviation: the larger of that of the model and that of the bootstrap.
    correlation : (q + 6, q + 6)
        Of the estimates and the bias, by the model.
    bias : (6,)
        Twist bias beside them [rad/s, m/s].
    explained : float
        Share of the weighted residual variance left by the bias alone.
    """

    value: Array
    sigma: Array
    correlation: Array
    bias: Array
    explained: float


@dataclass(frozen=True)
class PooledFit:
    """Normal equations of blocks of a recording, in (parameters, bias, residual).

    Attributes
    ----------
    blocks : (b, p + 7, p + 7)
    prior_mean, prior_sigma : (6,)
        Of the bias.
    """

    blocks: Array
    prior_mean: Array
    prior_sigma: Array

    @property
    def parameters(self) -> int:
        """How many."""
        return self.blocks.shape[1] - _BIAS - 1

    @property
    def residual(self) -> float:
        """Weighted sum of squares that the bias alone leaves."""
        return float(self._solved(self.blocks.sum(axis=0), self._columns([]))[1])

    def fit(self, which: Items[int]) -> Fitted:
        """Fit some of the parameters, by their columns, and the bias; the others are 0."""
        columns, many = self._columns(which), len(which)
        whole = self.blocks.sum(axis=0)
        solution, left = self._solved(whole, columns)
        cov = linear.inverse(self._information(whole, columns))
        # Where the data tell nothing of one, rounding may leave less than nothing of its variance.
        variance = np.diagonal(cov)
        model = np.sqrt(np.where(variance > 0.0, variance, np.inf))
        blocks = len(self.blocks)
        chosen = np.random.default_rng(_SEED).integers(0, blocks, (_DRAWS, blocks))
        times = (chosen[:, :, None] == np.arange(blocks)).sum(axis=1)
        drawn, _ = self._solved(np.tensordot(times, self.blocks, axes=1), columns)
        spread = np.std(drawn, axis=0) * np.sqrt(blocks / max(blocks - 1.0, 1.0))
        return Fitted(
            solution[:many],
            np.maximum(model, spread)[:many],
            cov / np.outer(model, model),
            solution[many:],
            float(1.0 - left / self.residual),
        )

    def explained(self, which: Items[int]) -> float:
        """Share of the weighted residual variance that some parameters explain together."""
        return float(1.0 - self._solved(self.blocks.sum(axis=0), self._columns(which))[1] / self.residual)

    def _columns(self, which: Items[int]) -> IntArray:
        first = self.parameters
        return np.concatenate([np.array(which, dtype=np.int64), np.arange(first, first + _BIAS)])

    def _information(self, gram: Array, columns: IntArray) -> Array:
        prior = np.concatenate([np.zeros(len(columns) - _BIAS), self.prior_sigma**-2.0])
        return np.asarray(gram[..., columns[:, None], columns] + np.diag(prior))

    def _solved(self, gram: Array, columns: IntArray) -> tuple[Array, Array]:
        """Solutions ``(..., q + 6)`` and the weighted sums of squares that they leave, ``(...)``."""
        pull = np.zeros(len(columns))
        pull[-_BIAS:] = self.prior_mean / self.prior_sigma**2
        right = gram[..., columns, -1] + pull
        solution = linear.solve(self._information(gram, columns), right)
        constant = gram[..., -1, -1] + np.sum((self.prior_mean / self.prior_sigma) ** 2)
        return solution, constant - np.sum(right * solution, axis=-1)


def pooled(
    found: SharedResiduals, *, dt: Array, density: Array, bias_mean: Array, bias_sigma: Array
) -> PooledFit:
    """Normal equations of a recording.

    The robust weights are those of the residuals that all parameters and a free motion of each frame leave.
    Those of the frame's own fit would favour the observations whose noise hides what is sought.

    Parameters
    ----------
    found : SharedResiduals
    dt : (T,)
        Length of the step that ends at each frame [s].
    density : (6,)
        White noise of the twist [rad/sqrt(s), m/sqrt(s)], above zero.
    bias_mean, bias_sigma : (6,)
        Prior of the bias; the standard deviations are above zero.
    """
    steps = _Steps(found, dt[np.unique(found.frame)][:, None] / density**2)
    fit = PooledFit(steps.blocks(found.weight), bias_mean, bias_sigma)
    weight = found.weight
    for _ in range(_REWEIGHTINGS):
        before, weight = weight, steps.reweighted(weight, fit.fit(range(fit.parameters)).value)
        fit = PooledFit(steps.blocks(weight), bias_mean, bias_sigma)
        if np.mean(np.abs(weight - before)) < _RESTS:
            break
    return fit


class _Steps:
    """Table ``(3 n, p + 7)`` of each step: derivatives by parameters and twist, and the residual."""

    def __init__(self, found: SharedResiduals, information: Array) -> None:
        table = np.concatenate([found.by_shared, found.by_twist, found.residual[:, :, None]], axis=2)
        start = np.unique(found.frame, return_index=True)[1][1:]
        self._tables = [part.reshape(-1, part.shape[2]) for part in np.split(table, start)]
        self._start, self._information = start, information

    def blocks(self, weight: Array) -> Array:
        """Normal equations of blocks of steps."""
        parts = np.split(np.repeat(weight, 3), 3 * self._start)
        steps = np.array(
            [
                _of_step(table * np.sqrt(part)[:, None], information)
                for table, part, information in zip(self._tables, parts, self._information, strict=True)
            ]
        )
        groups = np.array_split(np.arange(len(steps)), min(_BLOCKS, len(steps)))
        return np.array([steps[group].sum(axis=0) for group in groups])

    def reweighted(self, weight: Array, value: Array) -> Array:
        """Weights ``(m,)`` of what these values of the parameters and a motion of each step leave."""
        out = []
        for table, part in zip(self._tables, np.split(np.repeat(weight, 3), 3 * self._start), strict=True):
            left, motion = table[:, -1] - table[:, : len(value)] @ value, table[:, -_BIAS - 1 : -1]
            gram = motion.T @ (part[:, None] * motion)
            own = linear.solve(gram + _RIDGE * np.diag(np.diagonal(gram)), motion.T @ (part * left))
            left = left - motion @ own
            out.append(np.sum(left.reshape(-1, 3) ** 2, axis=1))
        return robust_weight(np.concatenate(out), 1.0)


def _of_step(table: Array, information: Array) -> Array:
    """Normal equations of one step, the error of its own twist integrated out."""
    gram = table.T @ table
    own = slice(-_BIAS - 1, -1)
    inside = gram[own, own]
    inside = inside + np.diag(information + _RIDGE * np.diagonal(inside))
    return np.asarray(gram - gram[:, own] @ linear.inverse(inside) @ gram[own])
