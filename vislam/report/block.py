"""The runs that have an estimate, and what their numbers of that estimate come to."""

from collections.abc import Mapping

from vislam.core.reference import Reference
from vislam.core.run import Estimate, Run
from vislam.evaluation import Evaluation
from vislam.evaluation.difference import ErrorDifference
from vislam.evaluation.evaluate import headline
from vislam.evaluation.held_out import Paired
from vislam.evaluation.metric import METRICS
from vislam.evaluation.scores import EstimatePair
from vislam.evaluation.spread import Spread
from vislam.report.consistency import Consistency, innovations
from vislam.report.words import listed, named

SURE = 0.05
"""p-value under which a difference is more than luck."""
_WORSE = 1.1
"""Times the error of a run without the camera from which one with it is called misled."""


class Block:
    """The runs that have an estimate, by their numbers of that estimate alone."""

    def __init__(
        self,
        runs: Mapping[str, Run],
        evaluation: Evaluation,
        estimate: Estimate,
        *,
        spread: Spread | None = None,
    ) -> None:
        self.runs = {name: run for name, run in runs.items() if estimate in run.estimates}
        self.estimate = estimate
        self.spread = spread
        self._evaluation = evaluation

    def told(self, *sentences: str) -> list[str]:
        """Those that say something, and of which estimate."""
        return [f"{self.estimate.capitalize()}: {sentence}" for sentence in sentences if sentence]

    def ranked(self, key: str, *, seeing: bool = False) -> list[tuple[float, str]]:
        """Complete and sound runs, or those of them that use the camera, by a metric, the smallest first."""
        sound = [
            name
            for name, run in self.runs.items()
            if run.complete and not self.degenerate(name) and not (seeing and run.blind)
        ]
        values = {name: self.value(name, key) for name in sound}
        return sorted((value, name) for name, value in values.items() if value is not None)

    def error(self, one: str, other: str) -> ErrorDifference | None:
        """ATE of one less that of another."""
        found = self._pair(one, other)
        if found is None or found[0].error is None:
            return None
        return found[0].error.turned() if found[1] else found[0].error

    def held_out(self, one: str, other: str) -> tuple[float, Paired] | None:
        """Share of the held-out tracks that one predicts better than another, and how sure that is."""
        found = self._pair(one, other)
        if found is None or found[0].held_out is None:
            return None
        scores, turned = found[0].held_out, found[1]
        return (1.0 - scores.better if turned else scores.better), scores

    def consistency_of(self, name: str) -> Consistency | None:
        """How well the errors of a run agree with its covariances; None where nothing says so."""
        return Consistency.of(self.runs[name], self._evaluation, self.estimate)

    def misled(self, reference: Reference, without: str, least: float) -> str:
        """Name those that are farther off than a run without the camera is, and sure of themselves."""
        spec = METRICS[headline(reference)]
        seeing = [name for name, run in self.runs.items() if run.complete and not run.blind]
        values = {name: self.value(name, spec.key) for name in seeing}
        found = sorted(
            (value, name)
            for name, value in values.items()
            if value is not None and value > _WORSE * least and self._overconfident(name)
        )
        if not found:
            return ""
        alone = listed([(least, without)], spec.digits, spec.unit)
        return (
            f"do not trust {named([name for _, name in found])}: farther from {reference.name} than "
            f"{without}, which uses no camera, and overconfident "
            f"({listed(found, spec.digits, spec.unit)}; {alone})."
        )

    def not_ranked(self) -> str:
        """Name the runs that are no answer to the data, and why."""
        told = [f"{name} ({'; '.join(reasons)})" for name in self.runs if (reasons := self.degenerate(name))]
        return f"degenerate and not ranked: {'; '.join(told)}." if told else ""

    def prediction(self, reference: Reference | None) -> str:
        """Say who predicts the held-out tracks best, and whether that is more than luck.

        Without a reference the lengths of the paths stand beside it: a path that is too short predicts well,
        too.
        """
        spec = METRICS["held_out_median"]
        ranked = self.ranked(spec.key)
        paths = "" if reference is not None else self._paths()
        if len(ranked) < 2:
            return paths
        first, second = ranked[0][1], ranked[1][1]
        found = self.held_out(first, second)
        if found is None:
            return paths
        better, scores = found
        if scores.p_value > SURE:
            told = f"{first} and {second} cannot be told apart ({scores.p_told})"
        else:
            told = f"{first} is better than {second} on {100.0 * better:.0f} % of them ({scores.p_told})"
        said = f"{spec.title}: {listed(ranked, spec.digits, spec.unit)}; {told}."
        return f"{said} {paths}".strip()

    def _paths(self) -> str:
        """Lengths of the paths beside that by the inertial data alone."""
        spec = METRICS["path_length"]
        ranked = self.ranked(spec.key, seeing=True)
        alone = [self.value(name, "path_length_inertial") for _, name in ranked]
        if not ranked or alone[0] is None:
            return ""
        told = listed(ranked, spec.digits, spec.unit)
        return f"Path length {told}; {alone[0]:.{spec.digits}f} {spec.unit} by the inertial data alone."

    def consistency(self) -> str:
        """Say who is overconfident, or conservative, and whether innovations are white."""
        told: dict[str, list[str]] = {}
        for name, run in self.runs.items():
            found = self.consistency_of(name)
            if run.complete and found is not None:
                told.setdefault(found.clause, []).append(name)
        said = [f"{named(names)}: {clause}" for clause, names in told.items()]
        if self.estimate == "filtered":
            said += innovations(self.runs, self._evaluation)
        return f"{'; '.join(said)}." if said else ""

    def _overconfident(self, name: str) -> bool:
        """Whether errors of a run are larger than it says."""
        found = self.consistency_of(name)
        return found is not None and found.word == "overconfident"

    def degenerate(self, name: str) -> tuple[str, ...]:
        """Why the estimate of a run is no answer to the data; empty where it is one."""
        return self._evaluation.degenerate(name, self.estimate)

    def value(self, name: str, key: str) -> float | None:
        """A metric of a run."""
        return self._evaluation.value(name, key, self.estimate)

    def _pair(self, one: str, other: str) -> tuple[EstimatePair, bool] | None:
        """What is known of two runs, and whether they are the other way round there."""
        turned = (one, other) not in self._evaluation.pairs
        found = self._evaluation.pairs.get((other, one) if turned else (one, other))
        pair = None if found is None else found.estimates.get(self.estimate)
        return None if pair is None else (pair, turned)
