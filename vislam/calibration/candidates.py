"""What a calibration could write, scored on what it was not fitted to; what predicts worse is not written."""

from collections.abc import Mapping
from collections.abc import Sequence as Items
from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.calibration.cross_validation import FOLDS, Predicted, block_of, left_out, predicted
from vislam.calibration.likelihood import Evaluator
from vislam.calibration.parameters import Parameter, largest_of, lowest_of, scaled
from vislam.calibration.search import Maximum
from vislam.calibration.shared import without_shared
from vislam.calibration.trial import CLAIMED, Trial, objections, trials
from vislam.comparison.config import Config

_RAISINGS = 3
"""How often the pixel noise is raised at most."""
TOO_SHORT = "too short to be cross-validated"


@dataclass(frozen=True)
class Candidate:
    """A config that could be written.

    Attributes
    ----------
    name : str
    config : Config
    predicted : Predicted or None
        Blocks that were left out; None where the recording is too short for them.
    raised : float
        Factor of its pixel noise over what was fitted, so that it claims no more than it shows.
    trial, before : Trial
        The smoothed filter with it, and with the config from before.
    elsewhere : dict of str to float
        Log likelihood gained on other recordings, by name.
    objections : tuple of str
        Why it is not to be written; empty if it may be.
    """

    name: str
    config: Config
    predicted: Predicted | None
    raised: float
    trial: Trial
    before: Trial
    elsewhere: dict[str, float]
    objections: tuple[str, ...]


def left_out_points(maximum: Maximum, frames: int, chosen: list[Parameter]) -> list[Array]:
    """Maximum without each fold; none where a recording is too short."""
    block = block_of(frames)
    if not len(block):
        return []
    return [
        left_out(maximum, block % FOLDS == fold, lowest=lowest_of(chosen), largest=largest_of(chosen))
        for fold in range(FOLDS)
    ]


def score_candidates(
    candidates: Mapping[str, Config],
    before: Config,
    evaluator: Evaluator,
    also: Items[Evaluator],
    *,
    folds: list[Config],
    usable: BoolArray,
) -> list[Candidate]:
    """Score them.

    Parameters
    ----------
    candidates : mapping of str to Config
    before : Config
        That the calibration started from.
    evaluator : Evaluator
    also : sequence of Evaluator
        Of other recordings.
    folds : list of Config
        Config of the maximum without each fold; what else a candidate has is added. Empty: too short.
    usable : (n,)
        Observations that neither gate has rejected.
    """
    block = block_of(len(evaluator.dataset.sequence))
    first, *found = trials([before, *candidates.values()], evaluator)
    fitted = [
        _as_shown(_Fitted(config, one, 1.0), first, evaluator)
        for config, one in zip(candidates.values(), found, strict=True)
    ]
    jobs = [
        before,
        *(scaled(_with_noise_of(fold, one.config), one.scale) for one in fitted for fold in folds),
    ]
    values = evaluator.log_likelihoods(jobs, usable=usable) if folds else []
    scored = []
    for index, (name, one) in enumerate(zip(candidates, fitted, strict=True)):
        parts = values[1 + index * FOLDS : 1 + (index + 1) * FOLDS]
        gained = predicted(values[0], parts, block) if folds else None
        elsewhere = {
            other.dataset.sequence.name: _gain_elsewhere(other, before, one.config) for other in also
        }
        reasons = [*_predicts_worse(gained, elsewhere)]
        sequence = evaluator.dataset.sequence
        reasons += objections(one.trial, first, sequence=sequence, config=before)
        scored.append(
            Candidate(name, one.config, gained, one.scale, one.trial, first, elsewhere, tuple(reasons))
        )
    return scored


@dataclass(frozen=True)
class _Fitted:
    """A config whose pixel noise was scaled, its trial, and the factor."""

    config: Config
    trial: Trial
    scale: float


def _as_shown(fitted: _Fitted, before: Trial, evaluator: Evaluator) -> _Fitted:
    """Config whose pixel noise is raised until its covariances claim no more than it shows."""
    for _ in range(_RAISINGS):
        more = fitted.trial.overclaim(before)
        if more <= CLAIMED:
            break
        config = scaled(fitted.config, more)
        fitted = _Fitted(config, trials([config], evaluator)[0], fitted.scale * more)
    return fitted


def chosen_of(candidates: list[Candidate]) -> Candidate | None:
    """That which predicts best of those that nothing speaks against."""
    open_ = [one for one in candidates if not one.objections]
    return max(open_, key=lambda one: 0.0 if one.predicted is None else one.predicted.total, default=None)


def _predicts_worse(gained: Predicted | None, elsewhere: dict[str, float]) -> list[str]:
    if gained is None:
        return [TOO_SHORT]
    found = []
    if gained.total <= 0.0:
        found.append(f"blocks that were left out lose {-gained.total:.1f} of log likelihood")
    found += [
        f"{name} loses {-gain:.1f} of log likelihood" for name, gain in elsewhere.items() if gain <= 0.0
    ]
    return found


def _with_noise_of(fold: Config, candidate: Config) -> Config:
    """Fold with the priors of a candidate: of the bias and of the errors that all tracks share."""
    fold, own = without_shared(fold, as_in=candidate), candidate.noise
    return replace(fold, noise=replace(fold.noise, bias_mean=own.bias_mean, bias_sigma=own.bias_sigma))


def _gain_elsewhere(other: Evaluator, before: Config, after: Config) -> float:
    """Log likelihood that another recording gains, over the observations that both gates keep."""
    first, second = other.run(before), other.run(after)
    if not (first.complete and second.complete):
        return float("-inf")
    values = other.log_likelihoods([before, after], usable=~(first.gated | second.gated))
    return float(np.sum(values[1]) - np.sum(values[0]))
