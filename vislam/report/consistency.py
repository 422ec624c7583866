"""How well the errors of a run agree with its covariances, in words."""

from collections.abc import Mapping
from dataclasses import dataclass

from vislam.core.run import Beside, Estimate, Run
from vislam.evaluation import Evaluation
from vislam.evaluation.metric import BESIDE_TITLES, of_beside, of_statistic
from vislam.evaluation.smoothing import NAME as SMOOTHING
from vislam.evaluation.statistics import Statistic
from vislam.report.words import plain, times

_NEES = ("nees_pose", "nees_position_planar", "nees_position_aligned")
_MAIN: dict[Estimate, tuple[str, ...]] = {"filtered": (*_NEES, "nis"), "smoothed": (*_NEES, "fit")}
"""Statistics that speak for the consistency of an estimate, the first that a run has."""
_SPOKEN_OF: Beside = "considered"
"""Covariances that speak for a run that has them, in place of its own."""
_FEWEST = 2.0
"""Effective samples below which a value within its interval says nothing."""
_WHITE = 0.05
"""p-value under which innovations are not white."""


@dataclass(frozen=True)
class Consistency:
    """What speaks for the consistency of an estimate.

    Attributes
    ----------
    statistic : Statistic
    gap, coverage : float or None
        Errors over estimated sigmas, an axis, and share of the frames within the 90 % region; None without a
        NEES.
    smoothing : Statistic or None
        Of its smoothed less its filtered poses; None where it has not both.
    own : Statistic or None
        By its own covariances, where the others are with the shared errors considered; else None.
    """

    statistic: Statistic
    gap: float | None
    coverage: float | None
    smoothing: Statistic | None
    own: Statistic | None = None

    @classmethod
    def of(cls, run: Run, evaluation: Evaluation, estimate: Estimate) -> "Consistency | None":
        """Look it up; None for a run that has none."""
        found = (evaluation.statistic(run.name, key, estimate) for key in _MAIN[estimate])
        own = next((one for one in found if one is not None), None)
        if own is None:
            return None
        statistic = evaluation.statistic(run.name, of_beside(own.name, _SPOKEN_OF), estimate) or own
        part = statistic.name.removeprefix("nees_")
        gap, coverage = (
            evaluation.value(run.name, f"{key}_{part}", estimate) for key in ("scale_gap", "coverage_90")
        )
        moved = evaluation.statistic(run.name, SMOOTHING) if estimate == "smoothed" else None
        return cls(statistic, gap, coverage, moved, None if statistic is own else own)

    @property
    def word(self) -> str:
        """One word, or that there is none: from a single effective sample."""
        low, high = self.statistic.interval(0.95)
        if self.statistic.value > high:
            return "overconfident"
        if self.statistic.value < low:
            return "conservative"
        if self.statistic.samples > 1 and self.statistic.effective < _FEWEST:
            return "cannot be told"
        return "consistent"

    @property
    def sigmas(self) -> str:
        """How wrong the sigmas are; nothing if nobody knows, or they are right."""
        if self.gap is None or self.word not in ("overconfident", "conservative"):
            return ""
        if self.word == "overconfident" and self.gap > 1.0:
            return f"{times(self.gap)} times too small"
        if self.word == "conservative" and 0.0 < self.gap < 1.0:
            return f"{times(1.0 / self.gap)} times too large"
        return ""

    @property
    def clause(self) -> str:
        """What there is to say of one run, or of several alike, after a colon."""
        low, high = self.statistic.interval(0.95)
        held = "" if self.coverage is None else f"{100.0 * self.coverage:.0f} % within the 90 % region"
        sigmas = f"sigmas {self.sigmas}" if self.sigmas else ""
        word = self.word if self.word != "cannot be told" else "cannot be told from one effective sample"
        told = [word, *filter(None, [sigmas, held])]
        title = of_statistic(self.statistic.name).title.partition(" ")[0]
        alone, how = "", ""
        if self.own is not None:
            alone, how = (
                f"; {plain(self.own.value)} by its own covariance",
                f" with {BESIDE_TITLES[_SPOKEN_OF]}",
            )
        numbers = f"({title} {plain(self.statistic.value)}{how}, {low:.2g} to {high:.2g} expected{alone})"
        return f"{', '.join(told)} {numbers}{self._moved()}"

    def _moved(self) -> str:
        """Whether smoothing moved the poses farther than the covariances allow; nothing if it did not."""
        own = self.smoothing
        if own is None or own.value <= own.interval(0.95)[1]:
            return ""
        return f", moved by smoothing {times(own.value**0.5)} times as far as its covariances allow"


def innovations(runs: Mapping[str, Run], evaluation: Evaluation) -> list[str]:
    """Name the runs whose innovations are correlated, if there are any."""
    found = []
    for name, run in runs.items():
        lag = evaluation.value(name, "nis_autocorrelation")
        white = evaluation.value(name, "nis_white_p")
        if run.complete and lag is not None and white is not None and white < _WHITE:
            found.append(f"{name} {lag:.2f}")
    if not found:
        return []
    why = "covariances rest on independence that the data deny"
    return [f"innovations correlated (lag-1 {', '.join(found)}): {why}"]
