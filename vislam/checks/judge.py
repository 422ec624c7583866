"""Whether results are as demanded."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

from vislam.base.errors import ConfigError
from vislam.checks.saved import Saved
from vislam.checks.settings import SAVED, Check, refuse_unknown
from vislam.core.reference import Reference
from vislam.core.run import ESTIMATES, Estimate, Run
from vislam.evaluation import Evaluation
from vislam.evaluation.lookup import Lookup


@dataclass(frozen=True)
class Verdict:
    """What became of a check.

    Attributes
    ----------
    check : str
        What was demanded.
    holds : bool
    measured : str
        What was found, or why nothing was.
    estimator : str
    name : str
        Key of the metric, or name of the statistic.
    convention : str
        What the number is, for a statistic: its error, axes, gauge and covariance.
    estimate : "filtered", "smoothed" or None
        Of which poses it is; None for a number of the run as a whole, or where there is none.
    """

    check: str
    holds: bool
    measured: str
    estimator: str
    name: str
    convention: str = ""
    estimate: Estimate | None = None

    def line(self) -> str:
        """One line of text."""
        return f"{'holds' if self.holds else 'FAILS'}  {self.check}: {self.measured}"

    def record(self) -> dict[str, object]:
        """Plain data for JSON."""
        return asdict(self)


class Demanding(Protocol):
    """A config, as far as it demands something of results."""

    @property
    def checks(self) -> tuple[Check, ...]:
        """What is demanded."""
        ...

    @property
    def false_alarm_rate(self) -> float:
        """Chance that consistent estimators fail a test."""
        ...

    @property
    def estimators(self) -> Mapping[str, Any]:
        """The runs, by their names."""
        ...


@dataclass(frozen=True)
class Checklist:
    """All that is demanded of the results of a comparison.

    Attributes
    ----------
    checks : tuple of Check
    false_alarm_rate : float
        Of all tests of consistency together: the chance that sound results fail one.
    saved : Saved or None
        What ``times: saved`` means.
    """

    checks: tuple[Check, ...]
    false_alarm_rate: float
    saved: Saved | None = None

    @classmethod
    def of(cls, config: Demanding, *, saved: Saved | None = None, tolerance: float = 0.05) -> "Checklist":
        """Checklist of a config.

        With saved results, and no check of the config that uses them, no error may have become larger than
        them by more than a share ``tolerance``.

        Raises
        ------
        ConfigError
            If a check names a run that there is not, or saved results that there are not.
        DataError
            If there is nothing to compare in the saved results.
        """
        checks = config.checks
        refuse_unknown(checks, config.estimators)
        of_saved = [index for index, check in enumerate(checks) if check.times == SAVED]
        if of_saved and saved is None:
            raise ConfigError(
                f"checks.{of_saved[0]}.times: no saved results are given; name them with "
                "--against results/<id>"
            )
        if saved is not None and not of_saved:
            checks += saved.checks(tuple(config.estimators), tolerance=tolerance)
        return cls(checks, config.false_alarm_rate, saved)

    def refuse_other(self, *, digest: str, reference: Reference | None) -> None:
        """Raise DataError if the saved results are of other data than are here."""
        if self.saved is not None:
            self.saved.refuse_other(digest=digest, reference=None if reference is None else reference.name)

    def judge(self, runs: Mapping[str, Run], evaluation: Evaluation) -> list[Verdict]:
        """Judge results, check by check."""
        judge = _Judge(self, runs, evaluation)
        return [judge.verdict(check) for check in self.checks]


_RERUN_NOISE = {"m": 1e-5, "px": 1e-6, "deg": 1e-5, "deg/100m": 1e-5, "%": 1e-5}
"""By how much an error changes where the same runs again on another machine, by its unit."""


def rerun_noise(unit: str) -> float:
    """Difference between two runs of the same that says nothing; 0 for a unit of which none is known.

    The linear algebra rounds otherwise on another processor. With OpenBLAS as for another one (its core type
    Prescott in place of Haswell) no error of ``ds3`` changed by more than 1.0e-6 m and 6.9e-8 px, none of
    ``tiny`` by more than 2e-11 deg and 8e-13 %; ten times that, and no less than 1e-5 of an angle or a share.
    """
    return _RERUN_NOISE.get(unit, 0.0)


def summary(verdicts: Sequence[Verdict]) -> str:
    """How many checks do not hold, of how many."""
    failed = sum(not verdict.holds for verdict in verdicts)
    return f"{failed} of {len(verdicts)} checks do not hold" if failed else f"all {len(verdicts)} checks hold"


def read_checklist(
    config: Demanding, *, against: Path | None, tolerance: float, schema_version: int
) -> Checklist:
    """Checklist of a config, and of saved results if they are named."""
    saved = None if against is None else Saved.read(against, schema_version=schema_version)
    return Checklist.of(config, saved=saved, tolerance=tolerance)


@dataclass(frozen=True)
class _Judge:
    checklist: Checklist
    runs: Mapping[str, Run]
    evaluation: Evaluation

    def verdict(self, check: Check) -> Verdict:
        incomplete = [name for name in check.runs if not self.runs[name].complete]
        if incomplete:
            error = self.runs[incomplete[0]].log.error
            return _verdict(check, False, f"{incomplete[0]} is incomplete: {error}")
        return self._test(check) if check.test is not None else self._bound(check)

    def _bound(self, check: Check) -> Verdict:
        estimate = self._estimate(check)
        found = self.evaluation.metric(check.estimator, check.name, estimate)
        if found is None:
            return _verdict(check, False, self._missing(check, estimate))
        value, unit = found.value, "" if found.unit == "1" else f" {found.unit}"
        factor, scale = self._scale(check, estimate, unit)
        if factor is None:
            return _verdict(check, False, scale)
        low = None if check.at_least is None else check.at_least * factor
        high = None if check.at_most is None else check.at_most * factor
        # Written so that a NaN on either side does not hold.
        noise = rerun_noise(found.unit) if check.times == SAVED else 0.0
        holds = (low is None or value >= low - noise) and (high is None or value <= high + noise)
        told = _verdict(check, holds, f"{value:.4g}{unit}{scale}", unit if check.times is None else "")
        return replace(told, estimate=found.estimate)

    def _estimate(self, check: Check) -> Estimate:
        """The estimate that a check is about: of two runs, the last that they share."""
        if check.estimate is not None:
            return check.estimate
        names = [check.estimator] if check.times in (None, SAVED) else [check.estimator, str(check.times)]
        return min((self.evaluation.final(name) for name in names), key=ESTIMATES.index)

    def _scale(self, check: Check, estimate: Estimate, unit: str) -> tuple[float | None, str]:
        """What the bounds are multiples of, and its description; None if there is nothing, and why."""
        if check.times is None:
            return 1.0, ""
        if check.times == SAVED:
            saved = self.checklist.saved
            assert saved is not None
            factor = Lookup(saved.values).find(check.estimator, check.name, estimate)
            lacking = [name for name in check.runs if not saved.complete.get(name, False)]
            if factor is None or lacking:
                why = f"no complete run of {lacking[0]}" if lacking else f"no {check.name}"
                return None, f"{why} in {saved.path}"
            return factor, f", saved {factor:.4g}{unit}"
        factor = self.evaluation.value(check.times, check.name, estimate)
        if factor is None:
            return None, f"{check.times} has no {check.name}"
        return factor, f", {check.times} {factor:.4g}{unit}"

    def _test(self, check: Check) -> Verdict:
        """Two-sided test at the corrected level.

        Bonferroni: the rate is shared out evenly, which holds however the statistics depend on each other
        and leaves a verdict the same whatever the others come to. Holm's method would reject more, but only
        once another has been rejected, and then the results have failed anyway.
        """
        estimate = self._estimate(check)
        found = self.evaluation.statistic(check.estimator, check.name, estimate)
        if found is None:
            of = "" if check.estimate is None else f" of its {estimate} poses"
            return _verdict(check, False, f"{check.estimator} has no such statistic{of}")
        tests = sum(other.test is not None for other in self.checklist.checks)
        rate = self.checklist.false_alarm_rate
        low, high = found.interval(1.0 - rate / tests)
        together = f"{rate:g} for {tests} tests together, Bonferroni" if tests > 1 else f"{rate:g}"
        measured = (
            f"{found.value:.4g}, expected {low:.4g} to {high:.4g} (p {found.p_value():.2g}, "
            f"{found.effective:.4g} effective of {found.samples} samples, "
            f"{found.freedom:.3g} degrees of freedom each, false-alarm rate {together})"
        )
        told = _verdict(check, low <= found.value <= high, measured)
        own = (check.estimator, check.name, estimate) in self.evaluation.statistics
        return replace(told, convention=found.convention, estimate=estimate if own else None)

    def _missing(self, check: Check, estimate: Estimate) -> str:
        known = self.evaluation.keys(check.estimator, estimate)
        of = "" if check.estimate is None else f" of its {estimate} poses"
        return f"{check.estimator} has no such metric{of}; it has {', '.join(known) or 'none'}"


def _verdict(check: Check, holds: bool, measured: str, unit: str = "") -> Verdict:
    return Verdict(_text(check, unit), bool(holds), measured, check.estimator, check.name)


def _text(check: Check, unit: str) -> str:
    """What a check demands, in words."""
    name = check.name if check.estimate is None else f"{check.estimate} {check.name}"
    if check.test is not None:
        return f"{check.estimator} {name} is that of a consistent estimator"
    bounds = []
    if check.at_least is not None:
        bounds.append(f"at least {check.at_least:g}")
    if check.at_most is not None:
        bounds.append(f"at most {check.at_most:g}")
    of = {None: unit, SAVED: " times the saved"}.get(check.times, f" times that of {check.times}")
    return f"{check.estimator} {name} {' and '.join(bounds)}{of}"
