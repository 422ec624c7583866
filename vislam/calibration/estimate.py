"""The calibration: choose observations by the gate, maximise, choose again, until both have converged."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from vislam.base.errors import ConfigError, DivergedError
from vislam.base.types import Array, BoolArray
from vislam.base.workers import Workers
from vislam.calibration.likelihood import Evaluator
from vislam.calibration.match import matching_bias
from vislam.calibration.parameters import MATCH, Parameter
from vislam.calibration.search import ROUNDS, Round, maximise
from vislam.comparison.config import Config
from vislam.comparison.open import Dataset, require_usable
from vislam.core.run import Run
from vislam.core.step import TWIST_BIAS

_log = logging.getLogger("vislam.calibration")
_CHOICES = 3
"""How often the gate may choose anew."""
_RESTS = 0.002
"""Share of the observations whose change of side ends the choosing."""
_MATCH_RESTS = 0.5
"""Change of the match level, in its standard deviations, that ends it."""
_LARGEST_LOG = 0.7
_LEVELLINGS, _LEVEL = 3, 0.05
"""How often the pixel noise is scaled at most, and how near to 1 the NIS must come."""
_LARGEST_OFFSET_STEPS = 10.0


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
        With all that was estimated.
    parameters : list of Calibrated
    bias, bias_sigma : (6,)
        Twist bias over the sequence and its standard deviation [rad/s, m/s].
    before, after : Run
        The filter with the config it started from and with the calibrated one, each with its own gate.
    """

    config: Config
    parameters: list[Calibrated]
    bias: Array
    bias_sigma: Array
    before: Run
    after: Run


def calibrate(
    config: Config,
    dataset: Dataset,
    chosen: list[Parameter],
    *,
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
    processes : int
        How many filters run side by side.
    say : callable
        Is given a line after each round.
    keep : callable
        Is given the best config so far after each round, and which round that is.

    Raises
    ------
    ConfigError
        If the model of motion is raw inertia, of which nothing is calibrated here.
    DataError
        If there is nothing to calibrate on.
    DivergedError
        If the filter does not finish with the config it starts from, or worker processes are lost again and
        again.
    """
    if processes < 1:
        raise ValueError(f"processes must be >= 1, got {processes}")
    if config.motion != "odometry":
        raise ConfigError(
            "motion: expected odometry, whose noise is calibrated, got imu; set motion to odometry"
        )
    require_usable(dataset)
    workers = Workers(processes, say=say) if processes > 1 else None
    try:
        return _calibrate(config, chosen, Evaluator(dataset, config, workers), _Reporter(say, keep))
    finally:
        if workers is not None:
            workers.close()


@dataclass
class _Reporter:
    """Reports the progress of the calibration, and passes on the best config so far."""

    say: Callable[[str], None]
    keep: Callable[[Config, str], None]
    _began: float = field(default_factory=time.monotonic)
    _rounds: int = 0

    def round(self, config: Config, ended: Round, *, choice: int) -> None:
        """Report a round that has ended with this config."""
        self._rounds += 1
        each = (time.monotonic() - self._began) / self._rounds
        left = ROUNDS - ended.number + ROUNDS * (_CHOICES - choice)
        where = f"choice {choice} of at most {_CHOICES}, round {ended.number} of at most {ROUNDS}"
        self.keep(config, where)
        self.say(
            f"{where}: log likelihood {ended.log_likelihood:.1f}, gained {ended.gain:.1f}; "
            f"{each:.1f} s a round, at most {_duration(each * left)} left"
        )


def _duration(seconds: float) -> str:
    return f"{seconds:.0f} s" if seconds < 100.0 else f"{seconds / 60.0:.0f} min"


def _calibrate(
    config: Config, chosen: list[Parameter], evaluator: Evaluator, reporter: _Reporter
) -> Calibration:
    before = _finished(evaluator.run(config))
    current = config
    match = matching_bias(current, evaluator)
    for choice in range(1, _CHOICES + 1):
        current = MATCH.write(current, match.pixels)
        run = _finished(evaluator.run(current))
        usable = ~run.gated
        start = current

        def evaluate(points: list[Array], start: Config = start, usable: BoolArray = usable) -> list[Array]:
            return evaluator.log_likelihoods([_at(start, chosen, point) for point in points], usable=usable)

        def ended(found: Round, start: Config = start, choice: int = choice) -> None:
            reporter.round(_at(start, chosen, found.point), found, choice=choice)

        largest = [_LARGEST_LOG if item.logarithmic else _LARGEST_OFFSET_STEPS * item.step for item in chosen]
        maximum = maximise(
            evaluate,
            np.array([item.searched(item.read(current)) for item in chosen]),
            steps=np.array([item.step for item in chosen]),
            lowest=np.array([np.log(item.lowest) if item.logarithmic else -np.inf for item in chosen]),
            largest=np.array(largest),
            on_round=ended,
        )
        current = _at(current, chosen, maximum.point)
        run = _finished(evaluator.run(current))
        changed = int(np.sum(run.gated == usable))
        reporter.say(
            f"choice {choice} of observations: {maximum.rounds} rounds, "
            f"log likelihood {maximum.log_likelihood:.1f}, NIS per degree of freedom {run.nis_per_dof:.3f}, "
            f"{changed} observations changed sides"
        )
        # The level of the match was read off with the noise from before this choice.
        again = matching_bias(current, evaluator)
        match_rests = abs(again.pixels - match.pixels) <= _MATCH_RESTS * again.sigma
        if (changed <= _RESTS * len(usable) and match_rests) or choice == _CHOICES:
            break
        match = again
    current, run = _levelled(current, evaluator, run, reporter)
    bias, bias_sigma = _bias(current, evaluator, run)
    start_sigma = np.hypot(
        bias_sigma, np.array(config.noise.bias_walk) * np.sqrt(run.stamp[-1] - run.stamp[0])
    )
    noise = replace(
        current.noise,
        bias_mean=tuple(bias.tolist()),
        bias_sigma=tuple(np.maximum(start_sigma, 1e-5).tolist()),
    )
    final = replace(current, noise=noise)
    after = _finished(evaluator.run(final))
    found = [
        _with_interval(item, config, item.searched(item.read(current)), sigma)
        for item, sigma in zip(chosen, maximum.sigma, strict=True)
    ]
    if match.found:
        level = MATCH.searched(match.pixels)
        found.append(_with_interval(MATCH, config, level, match.sigma / match.pixels))
    return Calibration(final, found, bias, bias_sigma, before, after)


def _levelled(config: Config, evaluator: Evaluator, run: Run, reporter: _Reporter) -> tuple[Config, Run]:
    """Config whose pixel noise is scaled until the NIS per degree of freedom of the gated filter is 1.

    The maximum sets it to 1 over the observations that it was sought on. Where the tails are heavy, the
    filter that runs with it lets others pass than those, and is overconfident.
    """
    for _ in range(_LEVELLINGS):
        ratio = run.nis_per_dof
        if abs(ratio - 1.0) < _LEVEL:
            break
        scale = float(np.sqrt(ratio))
        noise = replace(
            config.noise,
            pixel_sigma_px=config.noise.pixel_sigma_px * scale,
            drift_px=config.noise.drift_px * scale,
        )
        config = replace(config, noise=noise)
        run = _finished(evaluator.run(config))
        reporter.say(f"pixel noise times {scale:.3f}, for the NIS per degree of freedom was {ratio:.3f}")
    return config, run


def _bias(config: Config, evaluator: Evaluator, run: Run) -> tuple[Array, Array]:
    """Constant bias of the whole sequence and its standard deviation.

    Without a random walk the filter's last bias is the constant one given all the data: with the prior of the
    config, the maximum of the same likelihood.
    """
    steady = replace(config, noise=replace(config.noise, bias_walk=(0.0,) * 6))
    last = _finished(evaluator.run(steady, usable=~run.gated))
    bias = last.states[TWIST_BIAS]
    return bias.value[-1], bias.sigma[-1]


def _at(config: Config, chosen: list[Parameter], point: Array) -> Config:
    for item, searched in zip(chosen, point, strict=True):
        config = item.write(config, item.value(float(searched)))
    return config


def _finished(run: Run) -> Run:
    if not run.complete:
        raise DivergedError(f"the filter did not finish, so there is no likelihood: {run.log.error}")
    return run


def _with_interval(item: Parameter, config: Config, searched: float, sigma: float) -> Calibrated:
    needed = bool(np.isfinite(sigma))
    low = item.value(searched - 1.96 * sigma) if needed else 0.0
    high = item.value(searched + 1.96 * sigma) if needed else item.value(searched)
    return Calibrated(item, item.read(config), item.value(searched), low, high, needed)
