"""What a config can demand of its results."""

from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Annotated

from pydantic import BeforeValidator, Field
from pydantic.dataclasses import dataclass

from vislam.base.errors import ConfigError
from vislam.base.fields import STRICT
from vislam.base.former import metric_key
from vislam.core.run import Estimate

SAVED = "saved"
"""What ``times`` says for the saved results."""
Finite = Annotated[float, Field(allow_inf_nan=False)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Check:
    """A bound on a metric, or a test of consistency. What is missing or not a number does not hold."""

    estimator: str
    """The run it is about; two of them, ``ekf|isam2``, for a metric of how far they are apart."""
    metric: Annotated[str | None, BeforeValidator(metric_key)] = None
    """Key of a metric, as in ``metrics.json``."""
    test: str | None = None
    """Name of a statistic whose distribution is known if the run is consistent, such as ``nees_pose``."""
    estimate: Estimate | None = None
    """``filtered`` or ``smoothed``: of which poses; null: the final ones, smoothed if the run has them, else
    filtered. Of two runs, and in ``times``, both are of the same."""
    at_most: Finite | None = None
    """Largest value of the metric, in its unit or in ``times``."""
    at_least: Finite | None = None
    """Smallest value, alike."""
    times: str | None = None
    """The bounds are multiples of the same metric of this run, or, if it is ``saved``, of the same run in the
    saved results (``--against``)."""

    def __post_init__(self) -> None:
        """Reject a check without a requirement, or with two."""
        if (self.metric is None) == (self.test is None):
            raise ValueError("one of metric and test must be given")
        bounds = [bound for bound in (self.at_least, self.at_most) if bound is not None]
        if self.test is not None:
            if bounds or self.times is not None:
                raise ValueError("test has its bounds from false_alarm_rate: no at_most, at_least or times")
            return
        if not bounds:
            raise ValueError("at_most or at_least must be given")
        if bounds != sorted(bounds):
            raise ValueError(f"at_least must not be above at_most, got {bounds[0]:g} and {bounds[1]:g}")
        if self.times == self.estimator:
            raise ValueError("times must name another run, or saved")

    @property
    def name(self) -> str:
        """What is looked at: key of the metric, or name of the statistic."""
        return self.metric or self.test or ""

    @property
    def runs(self) -> tuple[str, ...]:
        """Runs that it needs."""
        other = [] if self.times in (None, SAVED) else [str(self.times)]
        return (*self.estimator.split("|"), *other)


def refuse_unknown(checks: Sequence[Check], estimators: Iterable[str]) -> None:
    """Raise ConfigError if a check names a run that there is not."""
    names = tuple(estimators)
    if SAVED in names and any(check.times == SAVED for check in checks):
        raise ConfigError(f"estimators.{SAVED}: name it otherwise, checks mean the saved results by that")
    pairs = {"|".join(pair) for pair in combinations(names, 2)}
    for index, check in enumerate(checks):
        if check.estimator not in names and check.estimator not in pairs:
            order = " (two in this order)" if "|" in check.estimator else ""
            raise _unknown(index, "estimator", names, check.estimator, order)
        if check.times not in (None, SAVED, *names):
            raise _unknown(index, "times", (*names, SAVED), str(check.times))


def _unknown(index: int, key: str, names: Iterable[str], got: str, order: str = "") -> ConfigError:
    return ConfigError(f"checks.{index}.{key}: expected one of {', '.join(names)}{order}, got {got}")
