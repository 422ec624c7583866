"""What a comparison comes to, in sentences: who is right, who predicts, who is overconfident, and the cost.

Filtered estimates are ranked among themselves, and smoothed ones are: never one against the other.
"""

from collections.abc import Iterator, Mapping

from vislam.core.reference import Reference
from vislam.core.run import ESTIMATES, Estimate, Run
from vislam.evaluation import Evaluation
from vislam.evaluation.evaluate import headline
from vislam.evaluation.lag import half_time
from vislam.evaluation.metric import METRICS, of_statistic
from vislam.evaluation.statistics import Statistic

_SURE = 0.05
"""p-value under which a difference is more than luck."""
_WORSE = 1.1
"""Times the error of a run without the camera from which one with it is called misled."""
_NEES = ("nees_pose", "nees_position_planar", "nees_position_aligned")
_MAIN: dict[Estimate, tuple[str, ...]] = {"filtered": (*_NEES, "nis"), "smoothed": (*_NEES, "fit")}
"""Statistics that speak for the consistency of an estimate, the first that a run has."""


def verdict(
    runs: Mapping[str, Run], evaluation: Evaluation, reference: Reference | None, *, unequal: str = ""
) -> list[str]:
    """Sentences, the most important first; each rests on numbers that are in ``metrics.json``.

    Parameters
    ----------
    runs : mapping of str to Run
    evaluation : Evaluation
    reference : Reference or None
    unequal : str
        In what the runs' information differed; empty if in nothing.
    """
    blocks = [_Block(runs, evaluation, estimate) for estimate in ESTIMATES]
    blocks = [block for block in blocks if block.runs]
    told = []
    if reference is None:
        told.append("There is no reference: what follows is from the data alone.")
    else:
        alone = _without_camera(runs, evaluation, headline(reference))
        if alone is not None:
            for block in blocks:
                told += block.told(block.misled(reference, *alone))
    if unequal:
        told.append(unequal)
    for block in blocks:
        told += block.told(block.accuracy(reference), block.not_ranked())
    for part in (_Block.prediction, _Block.consistency):
        for block in blocks:
            told += block.told(part(block))
    for block in blocks:
        told += block.told(*block.partings())
    told += _waiting(runs, evaluation, reference)
    for block in blocks:
        told += block.told(block.cost())
    return told


class _Block:
    """The runs that have an estimate, by their numbers of that estimate alone."""

    def __init__(self, runs: Mapping[str, Run], evaluation: Evaluation, estimate: Estimate) -> None:
        self.runs = {name: run for name, run in runs.items() if estimate in run.estimates}
        self._evaluation = evaluation
        self._estimate = estimate

    def told(self, *sentences: str) -> list[str]:
        """Those that say something, and of which estimate."""
        return [f"{self._estimate.capitalize()}: {sentence}" for sentence in sentences if sentence]

    def accuracy(self, reference: Reference | None) -> str:
        """Say who came closest."""
        if reference is None:
            return ""
        spec = METRICS[headline(reference)]
        ranked = self._ranked(spec.key)
        if not ranked:
            return "no estimator finished with a sound estimate, so none can be called closest."
        listed = _listed(ranked, spec.digits, spec.unit)
        if len(ranked) == 1:
            return f"{listed} from {reference.name} ({spec.title}), with none to compare it with."
        return f"closest to {reference.name} is {ranked[0][1]} ({spec.title}: {listed})."

    def misled(self, reference: Reference, without: str, least: float) -> str:
        """Name those that are farther off than a run without the camera is, and sure of themselves."""
        spec = METRICS[headline(reference)]
        seeing = [name for name, run in self.runs.items() if run.complete and not run.blind]
        values = {name: self._evaluation.value(name, spec.key, self._estimate) for name in seeing}
        found = sorted(
            (value, name)
            for name, value in values.items()
            if value is not None and value > _WORSE * least and self._overconfident(name)
        )
        if not found:
            return ""
        alone = _listed([(least, without)], spec.digits, spec.unit)
        return (
            f"do not trust {' and '.join(name for _, name in found)}: farther from {reference.name} than "
            f"{without}, which uses no camera, and overconfident "
            f"({_listed(found, spec.digits, spec.unit)}; {alone})."
        )

    def not_ranked(self) -> str:
        """Name the runs that are no answer to the data, and why."""
        told = [f"{name} ({'; '.join(reasons)})" for name in self.runs if (reasons := self._degenerate(name))]
        return f"degenerate and not ranked: {'; '.join(told)}." if told else ""

    def _degenerate(self, name: str) -> tuple[str, ...]:
        return self._evaluation.degenerate(name, self._estimate)

    def _ranked(self, key: str) -> list[tuple[float, str]]:
        """Complete and sound runs by a metric, the smallest first."""
        sound = [name for name, run in self.runs.items() if run.complete and not self._degenerate(name)]
        values = {name: self._evaluation.value(name, key, self._estimate) for name in sound}
        return sorted((value, name) for name, value in values.items() if value is not None)

    def prediction(self) -> str:
        """Say who predicts the held-out tracks best, and whether that is more than luck."""
        spec = METRICS["held_out_median"]
        ranked = self._ranked(spec.key)
        if len(ranked) < 2:
            return ""
        first, second = ranked[0][1], ranked[1][1]
        pairs = self._evaluation.pairs
        turned = (first, second) not in pairs
        found = pairs[(second, first) if turned else (first, second)].estimates[self._estimate].held_out
        if found is None:
            return ""
        better = 1.0 - found.better if turned else found.better
        if found.p_value > _SURE:
            told = f"{first} and {second} cannot be told apart (p {found.p_value:.2g})"
        else:
            told = (
                f"{first} is better than {second} on {100.0 * better:.0f} % of them (p {found.p_value:.1g})"
            )
        return f"{spec.title}: {_listed(ranked, spec.digits, spec.unit)}; {told}."

    def consistency(self) -> str:
        """Say who is overconfident, or conservative."""
        told = []
        for name, run in self.runs.items():
            statistic = self._main(name)
            if statistic is None or not run.complete:
                continue
            low, high = statistic.interval(0.95)
            word = "overconfident" if statistic.value > high else "conservative"
            if low <= statistic.value <= high:
                word = "consistent"
            title = of_statistic(statistic.name).title
            told.append(f"{name} is {word} ({title} {statistic.value:.3g}, {low:.2g} to {high:.2g} expected)")
        return f"{'; '.join(told)}." if told else ""

    def _overconfident(self, name: str) -> bool:
        """Whether errors of a run are larger than it says."""
        statistic = self._main(name)
        return statistic is not None and statistic.value > statistic.interval(0.95)[1]

    def _main(self, name: str) -> Statistic | None:
        found = (self._evaluation.statistic(name, key, self._estimate) for key in _MAIN[self._estimate])
        return next((statistic for statistic in found if statistic is not None), None)

    def partings(self) -> Iterator[str]:
        """Say which runs disagree beyond what they claim, from when on, and who claims more."""
        for (one, other), scores in self._evaluation.pairs.items():
            pair = scores.estimates.get(self._estimate)
            # Who has no landmarks has not seen the camera: that it parts from the rest tells nothing.
            if pair is None or not all(
                self.runs[name].complete and len(self.runs[name].landmarks) for name in (one, other)
            ):
                continue
            frame = None if pair.agreement is None else pair.agreement.parting()
            if pair.agreement is None or frame is None:
                continue
            certainty = pair.agreement.certainty()
            surer, less = (one, other) if certainty.overall < 1.0 else (other, one)
            share = min(certainty.overall, 1.0 / certainty.overall)
            along = certainty.smallest_along if surer == one else certainty.largest_along
            yield (
                f"{one} and {other} contradict each other from frame {frame} on: they are farther apart than "
                f"their covariances allow. {surer} estimates {share:.2g} times the variance of {less}, above "
                f"all in {along}."
            )

    def cost(self) -> str:
        """Say what the estimates took."""
        spec = METRICS["total_time_s"]
        ranked = self._ranked(spec.key)
        return f"{spec.title} {_listed(ranked, spec.digits, spec.unit)}." if ranked else ""


def _waiting(runs: Mapping[str, Run], evaluation: Evaluation, reference: Reference | None) -> Iterator[str]:
    """Say of each run within which time half of what smoothing buys has come."""
    keys = ([] if reference is None else [headline(reference)]) + ["held_out_median"]
    for name, one in evaluation.scores.items():
        if not one.lags or not runs[name].complete:
            continue
        told = []
        for key in keys:
            half, spec = half_time(one.lags, key), METRICS[key]
            if half is None:
                continue
            when = (
                f"later than {half.longest:.2g} s" if half.seconds is None else f"within {half.seconds:.2g} s"
            )
            ends = f"{half.filtered:.{spec.digits}f} to {half.smoothed:.{spec.digits}f} {spec.unit}"
            told.append(f"{when} of the {spec.short_title} ({ends})")
        if told:
            yield f"{name}: half of what smoothing buys comes {' and '.join(told)}."
        else:
            yield f"{name}: smoothing buys less than a hundredth of its errors, however long one waits."


def _without_camera(runs: Mapping[str, Run], evaluation: Evaluation, key: str) -> tuple[str, float] | None:
    """The best run that uses no camera, and how far off it is; None if there is none."""
    values = {
        name: evaluation.value(name, key, "filtered")
        for name, run in runs.items()
        if run.blind and run.complete
    }
    known = [(value, name) for name, value in values.items() if value is not None]
    return min(known)[::-1] if known else None


def _listed(ranked: list[tuple[float, str]], digits: int, unit: str) -> str:
    return ", ".join(f"{name} {value:.{digits}f} {unit}" for value, name in ranked)
