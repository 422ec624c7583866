"""What a comparison comes to, in sentences: who is right, who predicts, who claims too much, and the cost."""

from collections.abc import Mapping

from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.evaluation import Evaluation
from vislam.evaluation.evaluate import headline
from vislam.evaluation.scores import RunScores
from vislam.evaluation.statistics import Statistic

_SURE = 0.05
"""p-value under which a difference is more than luck."""
_MAIN = ("nees_pose", "nees_position_planar", "nees_position_aligned", "fit", "nis")
"""Statistics that speak for a run's consistency, the first that it has."""


def verdict(runs: Mapping[str, Run], evaluation: Evaluation, reference: Reference | None) -> list[str]:
    """Sentences, the most important first; each rests on numbers that are in ``metrics.json``."""
    told = [
        _accuracy(runs, evaluation, reference),
        _not_ranked(runs, evaluation),
        _prediction(runs, evaluation),
        _claims(runs, evaluation),
        *_partings(runs, evaluation),
        _cost(runs, evaluation),
    ]
    return [sentence for sentence in told if sentence]


def _accuracy(runs: Mapping[str, Run], evaluation: Evaluation, reference: Reference | None) -> str:
    """Say who came closest, or that nobody can tell."""
    if reference is None:
        return "There is no reference: what follows is from the data alone."
    ranked = _ranked(runs, evaluation, headline(reference))
    if not ranked:
        return "No estimator finished with a sound estimate, so none can be called closest."
    listed = ", ".join(f"{name} {value:.2f} m" for value, name in ranked)
    return f"Closest to {reference.name} is {ranked[0][1]} (ATE after rigid alignment: {listed})."


def _not_ranked(runs: Mapping[str, Run], evaluation: Evaluation) -> str:
    """Name the runs that are no answer to the data, and why."""
    told = [f"{name} ({'; '.join(reasons)})" for name in runs if (reasons := evaluation.degenerate(name))]
    return f"Degenerate and not ranked: {'; '.join(told)}." if told else ""


def _ranked(runs: Mapping[str, Run], evaluation: Evaluation, key: str) -> list[tuple[float, str]]:
    """Complete and sound runs by a metric, the smallest first."""
    sound = [name for name, run in runs.items() if run.complete and not evaluation.degenerate(name)]
    values = {name: evaluation.value(name, key) for name in sound}
    return sorted((value, name) for name, value in values.items() if value is not None)


def _prediction(runs: Mapping[str, Run], evaluation: Evaluation) -> str:
    """Say who predicts the held-out tracks best, and whether that is more than luck."""
    ranked = _ranked(runs, evaluation, "held_out_median")
    if len(ranked) < 2:
        return ""
    listed = ", ".join(f"{name} {value:.2f} px" for value, name in ranked)
    first, second = ranked[0][1], ranked[1][1]
    turned = (first, second) not in evaluation.pairs
    found = evaluation.pairs[(second, first) if turned else (first, second)].held_out
    if found is None:
        return ""
    better = 1.0 - found.better if turned else found.better
    if found.p_value > _SURE:
        told = f"{first} and {second} cannot be told apart (p {found.p_value:.2g})"
    else:
        told = f"{first} is better than {second} on {100.0 * better:.0f} % of them (p {found.p_value:.1g})"
    return f"Tracks kept back from all, median error: {listed}; {told}."


def _claims(runs: Mapping[str, Run], evaluation: Evaluation) -> str:
    """Say who claims too much or too little of itself."""
    told = []
    for name, scores in evaluation.scores.items():
        statistic = _main(scores)
        if statistic is None or not runs[name].complete:
            continue
        low, high = statistic.interval(0.95)
        word = "claims too much" if statistic.value > high else "claims too little"
        if low <= statistic.value <= high:
            word = "is consistent"
        label = statistic.name.replace("nees", "NEES").replace("nis", "NIS").replace("_", " ")
        told.append(f"{name} {word} ({label} {statistic.value:.3g}, {low:.2g} to {high:.2g} expected)")
    return f"Of its own accuracy, {'; '.join(told)}." if told else ""


def _main(scores: RunScores) -> Statistic | None:
    return next((scores.statistics[key] for key in _MAIN if key in scores.statistics), None)


def _partings(runs: Mapping[str, Run], evaluation: Evaluation) -> list[str]:
    """Say which runs disagree beyond what they claim, from when on, and who claims more."""
    told = []
    for (one, other), scores in evaluation.pairs.items():
        found = scores.agreement
        # Who has no landmarks has not seen the camera: that it parts from the rest tells nothing.
        if found is None or not all(
            runs[name].complete and len(runs[name].landmarks) for name in (one, other)
        ):
            continue
        frame, certainty = found.parting(), found.certainty()
        if frame is None:
            continue
        surer, less = (one, other) if certainty.overall < 1.0 else (other, one)
        share = min(certainty.overall, 1.0 / certainty.overall)
        along = certainty.smallest_along if surer == one else certainty.largest_along
        told.append(
            f"{one} and {other} contradict each other from frame {frame} on: they are farther apart than "
            f"they claim to be uncertain. {surer} claims {share:.2g} times the variance of {less}, above all "
            f"in {along}."
        )
    return told


def _cost(runs: Mapping[str, Run], evaluation: Evaluation) -> str:
    ranked = _ranked(runs, evaluation, "total_time_s")
    return f"Time in all: {', '.join(f'{name} {value:.1f} s' for value, name in ranked)}." if ranked else ""
