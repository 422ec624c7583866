"""Level of the stereo-matching bias, from the errors that the filter has estimated.

Their distribution has heavy tails, which a Gaussian likelihood would follow; so the level is the one at which
the median error is what the filter expects: a fixed point, with a robust standard deviation in place of the
maximum.
"""

from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array
from vislam.calibration.likelihood import Evaluator, Gated
from vislam.comparison.config import Config

_ITERATIONS = 4
MATCH_RESTS = 0.5
"""Change of the level, in its standard deviations, that ends its iterations."""
_KNOWN = 0.5
"""A stereo-matching bias counts once its variance has fallen to this share of its initial value."""
_FEWEST = 30
_NORMAL = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation from zero."""
_SPREAD = 1.166
"""Standard deviation of that estimate, times the square root of the number of samples, over the level."""


@dataclass(frozen=True)
class MatchingBias:
    """Level and its standard deviation [px]; ``found`` is False if too few errors ever became known."""

    pixels: float
    sigma: float
    found: bool


def matching_bias(config: Config, evaluator: Evaluator) -> MatchingBias:
    """Level of the stereo-matching bias on the evaluator's sequence, with the config's other settings."""
    level = max(config.noise.matching_bias_px, 0.1)
    for _ in range(_ITERATIONS):
        trial = replace(config, noise=replace(config.noise, matching_bias_px=level))
        again = matching_bias_of(trial, evaluator, evaluator.gated(trial))
        if not again.found:
            return replace(again, pixels=config.noise.matching_bias_px)
        before, level = level, again.pixels
        if abs(level - before) <= MATCH_RESTS * again.sigma:
            break
    return again


def matching_bias_of(config: Config, evaluator: Evaluator, gated: Gated) -> MatchingBias:
    """Level that explains the errors which the filter has estimated that ran with a config.

    It is an iteration of the fixed point: where it is the config's own, that is the level.
    """
    level = config.noise.matching_bias_px
    first_disparity = _first_disparities(evaluator)[gated.track]
    prior = (level / first_disparity) ** 2
    known = gated.variance < _KNOWN * prior
    if np.count_nonzero(known) < _FEWEST:
        return MatchingBias(level, np.inf, False)
    # What has been learnt of an error has the variance that its own has lost.
    learnt = 1.0 - gated.variance[known] / prior[known]
    pixels = gated.matching_bias[known] / np.sqrt(learnt) * first_disparity[known]
    level = max(_NORMAL * float(np.median(np.abs(pixels))), 0.02)
    return MatchingBias(level, float(_SPREAD * level / np.sqrt(len(pixels))), True)


def _first_disparities(evaluator: Evaluator) -> Array:
    """Disparity of the first observation of each track, by its id [px]."""
    sequence = evaluator.dataset.sequence
    track, first = np.unique(sequence.track, return_index=True)
    out = np.ones(int(track.max()) + 1)
    out[track] = sequence.disparity[first]
    return out
