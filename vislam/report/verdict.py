"""What a comparison comes to, in sentences: the answer, then accuracy, prediction, consistency and cost.

Filtered estimates are ranked among themselves, and smoothed ones are: never one against the other.
"""

from collections.abc import Iterator, Mapping

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


def verdict(
    runs: Mapping[str, Run],
    evaluation: Evaluation,
    reference: Reference | None,
    *,
    unequal: str = "",
    spread: Spread | None = None,
) -> list[str]:
    """Sentences, the most important first; each rests on numbers that are in ``metrics.json``.

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
    blocks = _blocks(runs, evaluation, spread)
    told = [*_misled(blocks, runs, evaluation, reference)]
    told += filter(None, [headline(blocks, reference, unequal=bool(unequal)), unequal])
    if reference is None:
        told.append("There is no reference: what is said is from the data alone.")
    for block in blocks:
        told += block.told(block.accuracy(reference), block.not_ranked(), robustness(block))
    for block in blocks:
        told += block.told(block.prediction(reference))
    for block in blocks:
        told += block.told(block.consistency())
    told += _waiting(runs, evaluation, reference)
    for block in blocks:
        told += block.told(block.cost())
    return told


def answer(
    runs: Mapping[str, Run],
    evaluation: Evaluation,
    reference: Reference | None,
    *,
    unequal: str = "",
    spread: Spread | None = None,
) -> list[str]:
    """What the terminal shows of the verdict: warnings of runs that are misled, and the headline."""
    blocks = _blocks(runs, evaluation, spread)
    found = headline(blocks, reference, unequal=bool(unequal))
    return [*_misled(blocks, runs, evaluation, reference), *filter(None, [found])]


def _blocks(runs: Mapping[str, Run], evaluation: Evaluation, spread: Spread | None) -> list[Block]:
    blocks = [Block(runs, evaluation, estimate, spread=spread) for estimate in ESTIMATES]
    return [block for block in blocks if block.runs]


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
