"""What a comparison comes to, in sentences: the answer, then what it rests on.

Filtered estimates are ranked among themselves, and smoothed ones are: never one against the other.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from vislam.core.reference import Reference
from vislam.core.run import ESTIMATES, Run
from vislam.evaluation import Evaluation
from vislam.evaluation.evaluate import headline as headline_key
from vislam.evaluation.lag import half_time
from vislam.evaluation.metric import METRICS
from vislam.evaluation.spread import Spread
from vislam.report.block import Block
from vislam.report.headline import headline
from vislam.report.robustness import robustness
from vislam.report.summary import summary_table
from vislam.report.table import Table


@dataclass(frozen=True)
class Verdict:
    """What is said, the most important first; it rests on numbers that are in ``metrics.json``.

    Attributes
    ----------
    answer : list of str
        Warnings of runs that are misled, and the headline: what a terminal shows.
    summary : Table
        A row for each estimate of each run: accuracy, covariance and cost.
    reasons : list of str
        What the answer rests on.
    """

    answer: list[str]
    summary: Table
    reasons: list[str]

    @property
    def sentences(self) -> list[str]:
        """All of them."""
        return [*self.answer, *self.reasons]


def verdict(
    runs: Mapping[str, Run],
    evaluation: Evaluation,
    reference: Reference | None,
    *,
    unequal: str = "",
    spread: Spread | None = None,
) -> Verdict:
    """Find it.

    Parameters
    ----------
    runs : mapping of str to Run
    evaluation : Evaluation
    reference : Reference or None
    unequal : str
        In what the runs' information differed; empty if in nothing.
    spread : Spread or None
        What choices of the settings do to the errors, as far as that is known.
    """
    blocks = [Block(runs, evaluation, estimate, spread=spread) for estimate in ESTIMATES]
    blocks = [block for block in blocks if block.runs]
    return Verdict(
        answer=[
            *_misled(blocks, runs, evaluation, reference),
            *headline(blocks, reference, unequal=bool(unequal)),
        ],
        summary=summary_table(blocks, reference),
        reasons=[*_limits(reference, unequal), *_reasons(blocks, runs, evaluation, reference)],
    )


def _limits(reference: Reference | None, unequal: str) -> Iterator[str]:
    """What limits all that is said."""
    if unequal:
        yield unequal
    if reference is None:
        yield "There is no reference: what is said is from the data alone."


def _reasons(
    blocks: list[Block], runs: Mapping[str, Run], evaluation: Evaluation, reference: Reference | None
) -> Iterator[str]:
    """Of each subject what is to be said of the filtered and of the smoothed estimates."""
    subjects = Block.not_ranked, robustness, lambda block: block.prediction(reference), Block.consistency
    for say in subjects:
        for block in blocks:
            yield from block.told(say(block))
    yield from _waiting(runs, evaluation, reference)


def _misled(
    blocks: list[Block], runs: Mapping[str, Run], evaluation: Evaluation, reference: Reference | None
) -> list[str]:
    """Warnings of runs that are worse than one without the camera and sure of themselves."""
    alone = None if reference is None else _without_camera(runs, evaluation, headline_key(reference))
    if reference is None or alone is None:
        return []
    return [text for block in blocks for text in block.told(block.misled(reference, *alone))]


def _waiting(runs: Mapping[str, Run], evaluation: Evaluation, reference: Reference | None) -> Iterator[str]:
    """Say of each run within which time half of what smoothing buys has come."""
    keys = ([] if reference is None else [headline_key(reference)]) + ["held_out_median"]
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
