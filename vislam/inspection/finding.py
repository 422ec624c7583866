"""Findings of an inspection: one a check, with its figures and the config lines that correct it."""

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from vislam.base.types import Array

Verdict = Literal["ok", "fault", "unclear", "note"]


@dataclass(frozen=True)
class Measured:
    """A number with its 95 % interval.

    Attributes
    ----------
    name, unit : str
    value, low, high : float
    """

    name: str
    unit: str
    value: float
    low: float
    high: float

    @classmethod
    def around(cls, name: str, unit: str, value: float, *, sigma: float) -> "Measured":
        """Value with the interval of a standard deviation."""
        return cls(name, unit, value, value - 1.96 * sigma, value + 1.96 * sigma)

    @property
    def sigma(self) -> float:
        """Standard deviation that the interval stands for."""
        return (self.high - self.low) / 3.92

    def __str__(self) -> str:
        """Value and interval."""
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.name} {self.value:.4g}{unit} ({self.low:.4g} to {self.high:.4g})"


@dataclass(frozen=True)
class Finding:
    """Outcome of one check.

    Attributes
    ----------
    check : str
    verdict : str
        ``fault``: the data, as the config reads and repairs it, is wrong here, and ``proposal`` answers it.
        ``unclear``: the data cannot tell. ``note``: nothing to decide.
    text : str
        What a person should know.
    measured : tuple of Measured
    counts : dict
    proposal : dict
        Values by dotted path of the config that answer a fault.
    settings : dict
        Values by dotted path that were measured, or that are the safe reading of what could not be told; a
        written config has them where it says nothing of its own.
    unknown : dict
        Dotted paths of what could not be told, each with the reason.
    """

    check: str
    verdict: Verdict
    text: str
    measured: tuple[Measured, ...] = ()
    counts: dict[str, float] = field(default_factory=dict)
    proposal: dict[str, Any] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)
    unknown: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Inspection:
    """All findings on a sequence, and what the figures are drawn from."""

    name: str
    findings: tuple[Finding, ...]
    series: dict[str, Array]

    def finding(self, check: str) -> Finding:
        """Finding of that check."""
        return next(finding for finding in self.findings if finding.check == check)

    @property
    def proposal(self) -> dict[str, Any]:
        """All proposed values by dotted path of the config."""
        return {path: value for finding in self.findings for path, value in finding.proposal.items()}

    @property
    def settings(self) -> dict[str, Any]:
        """All measured values by dotted path of the config."""
        return {path: value for finding in self.findings for path, value in finding.settings.items()}

    @property
    def unknown(self) -> dict[str, str]:
        """Reason by dotted path of what could not be determined."""
        return {path: reason for finding in self.findings for path, reason in finding.unknown.items()}


def robust_mean(values: Array, *, name: str, unit: str, blocks: int = 20) -> Measured:
    """Median of a time series with an interval that survives correlation: medians of successive blocks.

    Parameters
    ----------
    values : (n,)
    name, unit : str
    blocks : int
        Parts of the series, taken as independent.
    """
    values = values[np.isfinite(values)]
    if len(values) < 2:
        return Measured(name, unit, float("nan"), float("-inf"), float("inf"))
    parts = [float(np.median(part)) for part in np.array_split(values, min(blocks, len(values)))]
    # A median of medians is less efficient than a mean of them; blocks are few, so the mean it is.
    centre = float(np.median(values))
    error = 1.2 * float(np.std(parts, ddof=1)) / np.sqrt(len(parts))
    return Measured.around(name, unit, centre, sigma=error)


def robust_sigma(values: Array, *, name: str, unit: str, blocks: int = 20) -> Measured:
    """Standard deviation of the core of a series, with an interval from successive blocks."""
    values = np.abs(values[np.isfinite(values)])
    if len(values) < 2:
        return Measured(name, unit, float("nan"), 0.0, float("inf"))
    found = robust_mean(values, name=name, unit=unit, blocks=blocks)
    scale = 1.4826
    return Measured(name, unit, scale * found.value, scale * max(found.low, 0.0), scale * found.high)
