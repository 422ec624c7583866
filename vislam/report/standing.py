"""How each run of a block stands to the best of them, and whether that is more than the luck of the path."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from vislam.evaluation.difference import ErrorDifference
from vislam.report.block import Block

_ALIKE = 0.2
"""Share of the best error within which the interval of a difference lies if two runs agree."""
Word = Literal["alone", "lowest", "agrees", "worse", "not told apart"]


@dataclass(frozen=True)
class Standing:
    """A run beside the best.

    Attributes
    ----------
    name : str
    value : float
        Its error [m].
    word : str
        "agrees" where the interval of the difference is narrow, "not told apart" where it is wide or unknown.
    difference : ErrorDifference or None
        Its error less that of the best; None for the best, and where nothing is known of it.
    """

    name: str
    value: float
    word: Word
    difference: ErrorDifference | None


def standings(block: Block, ranked: Sequence[tuple[float, str]]) -> list[Standing]:
    """Those that are ranked, the best first."""
    if len(ranked) == 1:
        return [Standing(name, value, "alone", None) for value, name in ranked]
    return [_standing(block, value, name, *ranked[0]) for value, name in ranked]


def _standing(block: Block, value: float, name: str, least: float, best: str) -> Standing:
    if name == best:
        return Standing(name, value, "lowest", None)
    found = block.error(name, best)
    word: Word = "not told apart"
    if found is not None and found.real and _outlasts(block, name, best):
        word = "worse"
    elif found is not None and found.known and max(-found.low, found.high) <= _ALIKE * least:
        word = "agrees"
    return Standing(name, value, word, found)


def _outlasts(block: Block, worse: str, best: str) -> bool:
    """Whether a ranking is the same at all points of the neighbourhood, as far as they are known."""
    found = None if block.spread is None else block.spread.difference(worse, best, block.estimate)
    return found is None or found[0] > 0.0
