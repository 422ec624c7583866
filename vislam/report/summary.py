"""All that a choice between estimators needs in one table: accuracy, covariance and cost."""

from collections.abc import Sequence

from vislam.core.reference import Reference
from vislam.evaluation.evaluate import headline, mean_step_ms
from vislam.evaluation.metric import METRICS
from vislam.report.block import Block
from vislam.report.consistency import Consistency
from vislam.report.standing import Standing, standings
from vislam.report.table import Table
from vislam.report.words import interval


def summary_table(blocks: Sequence[Block], reference: Reference | None) -> Table:
    """A row for each estimate of each run, the best of each estimate first."""
    error = METRICS["held_out_median" if reference is None else headline(reference)]
    header = ["estimator", "estimate", error.label]
    if reference is not None:
        header += ["against the lowest [m]", METRICS["held_out_median"].label]
    header += ["estimated sigmas", "within the 90 % region", "mean step [ms]", METRICS["total_time_s"].label]
    return Table(header, [row for block in blocks for row in _rows(block, error.key, reference)])


def _rows(block: Block, key: str, reference: Reference | None) -> list[list[str]]:
    ranked = block.ranked(key, seeing=True)
    found = {} if reference is None else {one.name: one for one in standings(block, ranked)}
    first = [name for _, name in ranked]
    rows = []
    for name in (*first, *(name for name in block.runs if name not in first)):
        row = [name, block.estimate, _shown(block, name, key)]
        if reference is not None:
            row += [_against(block, name, found.get(name)), _shown(block, name, "held_out_median")]
        step = mean_step_ms(block.runs[name])
        row += [*_certainty(block.consistency_of(name)), "-" if step is None else f"{step:.1f}"]
        rows.append([*row, _shown(block, name, "total_time_s")])
    return rows


def _shown(block: Block, name: str, key: str) -> str:
    value = block.value(name, key)
    if value is None:
        return "-"
    places = METRICS[key].places([block.value(other, key) for other in block.runs])
    return f"{value:.{places}f}"


def _against(block: Block, name: str, standing: Standing | None) -> str:
    """How it stands to the best of its estimate, or why it is not ranked."""
    run = block.runs[name]
    if standing is None:
        return "incomplete" if not run.complete else "degenerate" if block.degenerate(name) else "no camera"
    found = standing.difference
    ends = f" ({interval(found, 2)})" if found is not None and found.known else ""
    return f"{standing.word}{ends}"


def _certainty(found: Consistency | None) -> list[str]:
    """What its covariances are worth: how wrong the sigmas are, and how often the 90 % region holds."""
    if found is None:
        return ["not given", "-"]
    share = "-" if found.coverage is None else f"{100.0 * found.coverage:.0f} %"
    return [found.sigmas or found.word, share]
