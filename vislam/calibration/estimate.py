"""The calibration: search, what was found as configs, and which of them predicts best."""

import logging
import time
from collections.abc import Callable
from collections.abc import Sequence as Items
from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array
from vislam.base.workers import Workers
from vislam.calibration.candidates import Candidate, chosen_of, left_out_points, score_candidates
from vislam.calibration.choices import finished, search
from vislam.calibration.likelihood import Evaluator
from vislam.calibration.parameters import MATCH, Parameter, at, scaled
from vislam.calibration.reporter import Reporter, Work
from vislam.calibration.shared import with_priors, with_shared, without_shared
from vislam.calibration.standstill import UNKNOWN, Standstill, standstill
from vislam.comparison.config import Config
from vislam.comparison.inertia import started
from vislam.comparison.open import Dataset, require_usable
from vislam.core.run import Run
from vislam.core.step import TWIST_BIAS
from vislam.evaluation.shared_errors import EstimatedError, estimated_errors
from vislam.models.imu import ACCEL_BIAS, GYRO_BIAS

_log = logging.getLogger("vislam.calibration")
_LEVELLINGS, _LEVEL = 3, 0.05
"""How often the pixel noise is scaled at most, and how near to 1 the NIS must come."""
_LEAST_BIAS_SIGMA = 1e-5


@dataclass(frozen=True)
class Calibrated:
    """One calibrated parameter.

    Attributes
    ----------
    parameter : Parameter
    before, value : float
        In the config it started from, and estimated.
    low, high : float
        95 % interval; a level at its lowest value has no lower end.
    needed : bool
        False for a level that ended at its lowest value.
    """

    parameter: Parameter
    before: float
    value: float
    low: float
    high: float
    needed: bool


@dataclass(frozen=True)
class Calibration:
    """What came out.

    Attributes
    ----------
    config : Config
        What is to be written: the best candidate, or the config from before.
    parameters : list of Calibrated
    bias, bias_sigma : (6,)
        Bias of the twist, or of gyro and accelerometer, over the sequence by the filter, and its standard
        deviation [rad/s, m/s or m/s^2]. No prior is made of them.
    shared : list of EstimatedError
        Errors that all tracks share, by the filter.
    standstill : Standstill
        What stops tell of the bias; a prior where they do.
    before, after : Run
        The filter with the config it started from and with the one that is written, each with its own gate.
    candidates : list of Candidate
        What could be written, with what it was scored by.
    best : Candidate or None
        None: each predicts worse than the config from before, which is written again.
    """

    config: Config
    parameters: list[Calibrated]
    bias: Array
    bias_sigma: Array
    shared: list[EstimatedError]
    standstill: Standstill
    before: Run
    after: Run
    candidates: list[Candidate]
    best: Candidate | None

    @property
    def rejected(self) -> str:
        """Why the config from before is written again; empty if it is not."""
        return "" if self.best is not None else "; ".join(self.candidates[0].objections)


def calibrate(
    config: Config,
    dataset: Dataset,
    chosen: list[Parameter],
    *,
    also: Items[Dataset] = (),
    keep_bias_prior: bool = False,
    processes: int = 1,
    say: Callable[[str], None] = _log.info,
    keep: Callable[[Config, str], None] = lambda config, where: None,
) -> Calibration:
    """Calibrate a config on a dataset, whose reference is never looked at.

    Parameters
    ----------
    config : Config
        Where the search starts.
    dataset : Dataset
        Repaired by that config.
    chosen : list of Parameter
    also : sequence of Dataset
        Other recordings, on which what was found is scored, too; repaired by the same config.
    keep_bias_prior : bool
        Leave the prior of the bias as it is, whatever stops tell of it.
    processes : int
        How many filters run side by side.
    say : callable
        Is given a line after each round.
    keep : callable
        Is given the best config so far after each round, and which round that is.

    Raises
    ------
    ConfigError
        If the model of motion is raw inertia, and the recording has none or does not tell its first state.
    DataError
        If there is nothing to calibrate on.
    DivergedError
        If the filter does not finish with the config it starts from, or worker processes are lost again and
        again.
    """
    if processes < 1:
        raise ValueError(f"processes must be >= 1, got {processes}")
    for one in (dataset, *also):
        require_usable(one)
    # One first state for all that is tried: what is compared is the noise.
    dataset, *also = (started(config, one) for one in (dataset, *also))
    workers = Workers(processes, say=say) if processes > 1 else None
    try:
        others = [Evaluator(one, config, workers) for one in also]
        known = keep_bias_prior or config.motion == "imu"
        rest = UNKNOWN if known else standstill(dataset.sequence)
        return _calibrate(
            config,
            chosen,
            Evaluator(dataset, config, workers),
            others,
            rest=rest,
            reporter=Reporter(say, keep, processes),
        )
    finally:
        if workers is not None:
            workers.close()


def _calibrate(
    config: Config,
    chosen: list[Parameter],
    evaluator: Evaluator,
    also: Items[Evaluator],
    *,
    rest: Standstill,
    reporter: Reporter,
) -> Calibration:
    began = time.monotonic()
    before = finished(evaluator.run(config))
    start = with_shared(config, searched=[item.name for item in chosen])
    reporter.begin(Work.of(len(chosen), processes=reporter.processes), run=time.monotonic() - began)
    searched = search(start, chosen, evaluator, reporter)
    current, run = _levelled(searched.config, evaluator, searched.run, reporter)
    # The pixel noise that was levelled belongs to each fold, too.
    scale = current.noise.pixel_sigma_px / searched.config.noise.pixel_sigma_px
    last = _steady(current, evaluator, run)
    bias, bias_sigma = _bias(last)
    shared = estimated_errors({last.name: last})
    plain = _with_bias(without_shared(current, as_in=config), config, rest)
    candidates = {
        "shared errors known": plain,
        "shared errors estimated": with_priors(plain, shared),
    }
    reporter.say("scored on parts of the recording that were not fitted")
    folds = [
        scaled(at(searched.config, chosen, point), scale)
        for point in left_out_points(searched.maximum, len(before.stamp), chosen)
    ]
    scored = score_candidates(
        candidates,
        config,
        evaluator,
        also,
        folds=folds,
        usable=~(before.gated | run.gated),
    )
    best = chosen_of(scored)
    final = config if best is None else best.config
    after = before if best is None else finished(evaluator.run(final))
    found = [
        _with_interval(item, config, item.searched(item.read(current)), sigma)
        for item, sigma in zip(chosen, searched.maximum.sigma, strict=True)
    ]
    if searched.match.found:
        level = MATCH.searched(searched.match.pixels)
        found.append(_with_interval(MATCH, config, level, searched.match.sigma / searched.match.pixels))
    return Calibration(
        config=final,
        parameters=found,
        bias=bias,
        bias_sigma=bias_sigma,
        shared=shared,
        standstill=rest,
        before=before,
        after=after,
        candidates=scored,
        best=best,
    )


def _with_bias(current: Config, config: Config, rest: Standstill) -> Config:
    """Config with the prior of the bias of the config from before, but for what a standstill tells.

    What the camera says of a bias is of its own calibration, too, so it becomes no prior.
    """
    noise = config.noise
    told = rest.sigma < np.array(noise.bias_sigma)
    mean = np.where(told, rest.bias, noise.bias_mean)
    sigma = np.where(told, np.maximum(rest.sigma, _LEAST_BIAS_SIGMA), noise.bias_sigma)
    changed = replace(current.noise, bias_mean=tuple(mean.tolist()), bias_sigma=tuple(sigma.tolist()))
    return replace(current, noise=changed)


def _levelled(config: Config, evaluator: Evaluator, run: Run, reporter: Reporter) -> tuple[Config, Run]:
    """Config whose pixel noise is raised until the NIS per degree of freedom of the gated filter is 1.

    The maximum sets it to 1 over the observations that it was sought on. Where the tails are heavy, the
    filter that runs with it lets others pass than those, and is overconfident.
    """
    for _ in range(_LEVELLINGS):
        ratio = run.nis_per_dof
        if ratio - 1.0 < _LEVEL:
            break
        scale = float(np.sqrt(ratio))
        config = scaled(config, scale)
        run = finished(evaluator.run(config))
        reporter.say(f"pixel noise times {scale:.3f}, for the NIS per degree of freedom was {ratio:.3f}")
    return config, run


def _steady(config: Config, evaluator: Evaluator, run: Run) -> Run:
    """Run whose last bias and shared errors are the constant ones given all the data.

    Without a random walk that is the maximum of the same likelihood, with the prior of the config.
    """
    if config.motion == "imu":
        # Biases of raw inertia do walk, and are those of the last frame.
        return finished(evaluator.run(config, usable=~run.gated))
    steady = replace(config, noise=replace(config.noise, bias_walk=(0.0,) * 6))
    return finished(evaluator.run(steady, usable=~run.gated))


def _bias(run: Run) -> tuple[Array, Array]:
    """Biases ``(6,)`` at the end of a run and their standard deviations."""
    names = (TWIST_BIAS,) if TWIST_BIAS in run.states else (GYRO_BIAS, ACCEL_BIAS)
    value = np.concatenate([run.states[name].value[-1] for name in names])
    return value, np.concatenate([run.states[name].sigma[-1] for name in names])


def _with_interval(item: Parameter, config: Config, searched: float, sigma: float) -> Calibrated:
    needed = bool(np.isfinite(sigma))
    low = item.value(searched - 1.96 * sigma) if needed else 0.0
    high = item.value(searched + 1.96 * sigma) if needed else item.value(searched)
    return Calibrated(item, item.read(config), item.value(searched), low, high, needed)
