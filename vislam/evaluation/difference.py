"""Whether one trajectory's ATE is larger than another's by more than the luck of the path.

Errors of successive poses are nearly the same, so frames are no independent trials. Blocks of the path are
drawn with replacement, the same for both trajectories, and the ATE of each over them is computed: the
circular block bootstrap (Politis and Romano, *A circular block-resampling procedure for stationary data*,
1992), of a paired difference.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.distributions import normal_quantile, t_quantile
from vislam.base.types import Array
from vislam.evaluation.statistics import effective_errors
from vislam.evaluation.trajectory import AbsoluteErrors

FEWEST_BLOCKS = 4.0
"""Blocks on a path below which nothing is said of a difference."""
_DRAWS = 2000
_ROUNDING = 1e-18
"""Share of the other's squared errors below which those of a trajectory say nothing of its correlation."""
_WIDER = 1.15
"""A block cuts correlations at its ends. For squares of exponential correlation and blocks of four times
their length the variance of the bootstrap is 1 - (1 - exp(-4)) / 4 = 0.755 of the true one: intervals are
wider by its root."""


@dataclass(frozen=True)
class ErrorDifference:
    """ATE of one trajectory less that of another, on the frames that both have.

    Attributes
    ----------
    value, low, high : float
        Difference and its 95 % interval [m]; NaN where there are too few blocks for an interval.
    blocks : float
        Blocks on the path: about how many independent pieces of evidence there are.
    """

    value: float
    low: float
    high: float
    blocks: float

    @property
    def known(self) -> bool:
        """Whether there are blocks enough for an interval of the difference."""
        return self.blocks >= FEWEST_BLOCKS

    @property
    def real(self) -> bool:
        """Whether the difference is more than luck."""
        return self.known and (self.low > 0.0 or self.high < 0.0)

    def turned(self) -> "ErrorDifference":
        """The second less the first."""
        return ErrorDifference(-self.value, -self.high, -self.low, self.blocks)


def ate_difference(one: AbsoluteErrors, other: AbsoluteErrors, *, seed: int = 0) -> ErrorDifference | None:
    """Difference of two ATEs with its interval; None without common frames.

    A block is twice as long as the difference of the squared errors stays correlated, and at least as long as
    the errors do, each by its sum of autocorrelations. The interval is that of the quantiles of the draws,
    widened for what blocks cut off and for how few they are, by Student's t. Of runs that err alike it
    excludes 0 in 3 to 8 % of drives as long as 20 and more correlation lengths, in up to a tenth where there
    are ten.

    Parameters
    ----------
    one, other : AbsoluteErrors
        Aligned alike, each by itself.
    seed : int
        Of the draws.
    """
    _, first, second = np.intersect1d(one.frame, other.frame, return_indices=True)
    if len(first) < 2:
        return None
    errors = one.position_error[first], other.position_error[second]
    squares = np.array([np.sum(part**2, axis=1) for part in errors])
    value = float(np.subtract(*np.sqrt(squares.mean(axis=1))))
    if np.array_equal(*squares):
        return ErrorDifference(value, value, value, float(len(first)))
    length = _block_length(errors, squares)
    blocks = squares.shape[1] / length
    if blocks < FEWEST_BLOCKS:
        return ErrorDifference(value, np.nan, np.nan, blocks)
    low, high = np.quantile(_drawn(squares, length, np.random.default_rng(seed)), [0.025, 0.975])
    wider = _WIDER * float(t_quantile(0.975, blocks - 1.0) / normal_quantile(0.975))
    return ErrorDifference(
        value, value + wider * (float(low) - value), value + wider * (float(high) - value), blocks
    )


def _block_length(errors: tuple[Array, Array], squares: Array) -> int:
    """Frames of a block, from errors ``(n, d)`` of both and their squares ``(2, n)``."""
    count = squares.shape[1]
    apart = squares[0] - squares[1]
    correlated = count / effective_errors((apart - apart.mean())[:, None])
    mean = squares.mean(axis=1)
    # Of a trajectory that is right to the last digits what is left is rounding.
    told = [part for part, size in zip(errors, mean, strict=True) if size > _ROUNDING * mean.max()]
    staying = count / min(map(effective_errors, told))
    return int(np.ceil(min(max(2.0 * correlated, staying), count)))


def _drawn(squares: Array, length: int, generator: np.random.Generator) -> Array:
    """Differences ``(draws,)`` of the ATEs over blocks of a path that is closed to a ring."""
    count = squares.shape[1]
    number = int(np.ceil(count / length))
    start = generator.integers(0, count, size=(_DRAWS, number))
    summed = np.concatenate([np.zeros((2, 1)), np.cumsum(np.tile(squares, 2), axis=1)], axis=1)
    mean = (summed[:, start + length] - summed[:, start]).sum(axis=2) / (number * length)
    return np.asarray(np.sqrt(mean[0]) - np.sqrt(mean[1]))
