"""The one sentence that answers the question: who is better, if anybody is, and whose covariance is wrong."""

from collections.abc import Sequence

from vislam.core.reference import Reference
from vislam.evaluation.difference import ErrorDifference
from vislam.evaluation.evaluate import headline as headline_key
from vislam.evaluation.metric import METRICS
from vislam.report.block import SURE, Block
from vislam.report.words import named, times

_ALIKE = 0.2
"""Share of the best error within which the interval of a difference lies if two runs agree."""


def headline(blocks: Sequence[Block], reference: Reference | None, *, unequal: bool) -> str:
    """Compose it; a block of runs each, filtered ones and smoothed ones.

    Parameters
    ----------
    blocks : sequence of Block
    reference : Reference or None
    unequal : bool
        Whether information is known to have differed between runs.
    """
    said = [f"{block.estimate}: {text}" for block in blocks if (text := _of_block(block, reference))]
    begin = _information(blocks, unequal=unequal)
    text = ". ".join(part[0].upper() + part[1:] for part in said)
    if begin and said:
        text = f"{begin}, {text[0].lower()}{text[1:]}"
    return f"{text}." if text else ""


def _information(blocks: Sequence[Block], *, unequal: bool) -> str:
    if unequal:
        return "On unequal information"
    seeing = [run for block in blocks for run in block.runs.values() if run.complete and not run.blind]
    stated = len({run.name for run in seeing}) > 1 and all(run.information for run in seeing)
    return "On equal information" if stated else ""


def _of_block(block: Block, reference: Reference | None) -> str:
    if reference is None:
        return _by_tracks(block)
    spec = METRICS[headline_key(reference)]
    ranked = block.ranked(spec.key, seeing=True)
    if not ranked:
        return "no estimator finished with a sound estimate"
    if len(ranked) == 1:
        value, name = ranked[0]
        return f"{name} {value:.{spec.digits}f} m with none to compare it with{_bold(block, [name])}"
    return _compared(block, ranked, spec.digits)


def _compared(block: Block, ranked: Sequence[tuple[float, str]], digits: int) -> str:
    """The best and who agrees with it, who is worse, and who is not told apart from it."""
    least, best = ranked[0]
    alike, unclear, worse = [ranked[0]], [], []
    for value, name in ranked[1:]:
        found = block.error(name, best)
        if found is not None and found.real and _outlasts(block, name, best):
            worse.append(f"{name} is {found.value:.{digits}f} m worse ({_interval(found, digits)})")
        elif found is not None and found.known and max(-found.low, found.high) <= _ALIKE * least:
            alike.append((value, name))
        else:
            more = f", {_interval(found, digits)} more" if found is not None and found.known else ""
            unclear.append(f"{name} ({value:.{digits}f} m{more})")
    parts = [_best(alike, digits, alone=not unclear), *worse]
    if unclear:
        parts.append(f"not told apart on this path {'is' if len(unclear) == 1 else 'are'} {named(unclear)}")
    return "; ".join(parts) + _bold(block, [name for _, name in ranked])


def _best(alike: Sequence[tuple[float, str]], digits: int, *, alone: bool) -> str:
    """The best, and those that are as good; ``alone`` says whether all others are known to be worse."""
    values = named([f"{value:.{digits}f}" for value, _ in alike])
    names = named([name for _, name in alike])
    if len(alike) > 1:
        return f"{names} agree, {values} m, {'neither' if len(alike) == 2 else 'none'} is better"
    return f"{names} is best, {values} m" if alone else f"{names} has {values} m"


def _interval(found: ErrorDifference, digits: int) -> str:
    return f"{found.low:.{digits}f} to {found.high:.{digits}f} m"


def _outlasts(block: Block, worse: str, best: str) -> bool:
    """Whether a ranking is the same at all points of the neighbourhood, as far as they are known."""
    found = None if block.spread is None else block.spread.difference(worse, best, block.estimate)
    return found is None or found[0] > 0.0


def _bold(block: Block, names: Sequence[str]) -> str:
    """Name those that are overconfident, by how much their sigmas are too small."""
    told: dict[str, list[str]] = {}
    for name in names:
        found = block.consistency_of(name)
        if found is not None and found.word == "overconfident":
            small = f" by sigmas {times(found.gap)} times too small" if found.sigmas and found.gap else ""
            told.setdefault(small, []).append(name)
    said = ", ".join(f"{named(some)}{small}" for small, some in told.items())
    return f"; overconfident: {said}" if said else ""


def _by_tracks(block: Block) -> str:
    """Without a reference: who predicts the held-out tracks best."""
    spec = METRICS["held_out_median"]
    ranked = block.ranked(spec.key, seeing=True)
    if len(ranked) < 2:
        return ""
    best = ranked[0][1]
    alike = [best]
    for _, name in ranked[1:]:
        found = block.held_out(best, name)
        if found is None or found[1].p_value > SURE:
            alike.append(name)
    values = ", ".join(f"{value:.{spec.digits}f}" for value, name in ranked if name in alike)
    rest = [f"{name} ({value:.{spec.digits}f} px)" for value, name in ranked if name not in alike]
    told = f"{named(alike)} predict{'s' if len(alike) == 1 else ''} the held-out tracks best ({values} px)"
    if len(alike) > 1:
        told = f"{named(alike)} predict the held-out tracks alike ({values} px)"
    return told + (f", {named(rest)} worse" if rest else "")
