"""What a neighbourhood of the settings does to the errors, in a sentence."""

from vislam.evaluation.metric import METRICS
from vislam.report.block import Block


def robustness(block: Block) -> str:
    """Say how far each error moves, and which rankings do not outlast it; nothing if that is not known."""
    spread = block.spread
    if spread is None:
        return ""
    spec = METRICS[spread.key]
    ranked = [name for _, name in block.ranked(spec.key, seeing=True)]
    ranges = {name: found for name in ranked if (found := spread.range_of(name, block.estimate)) is not None}
    if not ranges:
        return ""
    moved = ", ".join(f"{name} {low:.2f} to {high:.2f} {spec.unit}" for name, (low, high) in ranges.items())
    reversed_ = [
        f"{ranked[0]} before {name} ({found[0]:+.2f} to {found[1]:+.2f} {spec.unit})"
        for name in ranked[1:]
        if (found := spread.difference(name, ranked[0], block.estimate)) is not None and found[0] <= 0.0
    ]
    told = f"over {len(spread.points)} choices of held-out tracks and settings {spec.title} is {moved}"
    return f"{told}; no ranking: {', '.join(reversed_)}." if reversed_ else f"{told}."
