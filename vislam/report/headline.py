"""The sentence that answers the question: who is better, if anybody is, and whose covariance is wrong."""

from collections.abc import Sequence

from vislam.core.reference import Reference
from vislam.evaluation.evaluate import headline as headline_key
from vislam.evaluation.metric import METRICS
from vislam.report.block import SURE, Block
from vislam.report.standing import Standing, standings
from vislam.report.words import interval, named, times


def headline(blocks: Sequence[Block], reference: Reference | None, *, unequal: bool) -> list[str]:
    """Compose it, a sentence for each block of runs, filtered ones and smoothed ones.

    Parameters
    ----------
    blocks : sequence of Block
    reference : Reference or None
    unequal : bool
        Whether information is known to have differed between runs.
    """
    said = [f"{block.estimate}: {text}." for block in blocks if (text := _of_block(block, reference))]
    begin = _information(blocks, unequal=unequal)
    if begin and said:
        said[0] = f"{begin}, {said[0]}"
    return [text[0].upper() + text[1:] for text in said]


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
    digits = spec.places([value for value, _ in ranked])
    if len(ranked) == 1:
        value, name = ranked[0]
        return f"{name} {value:.{digits}f} m with none to compare it with{_bold(block, [name])}"
    return _compared(block, ranked, digits)


def _compared(block: Block, ranked: Sequence[tuple[float, str]], digits: int) -> str:
    """The best and who agrees with it, who is worse, and who is not told apart from it."""
    found = standings(block, ranked)
    alike = [one for one in found if one.word in ("lowest", "agrees")]
    unclear = [_unclear(one, digits) for one in found if one.word == "not told apart"]
    parts = [_best(alike, digits, alone=not unclear)]
    for one in found:
        if one.word == "worse" and one.difference is not None:
            more = f"{one.difference.value:.{digits}f} m worse ({interval(one.difference, digits)} m)"
            parts.append(f"{one.name} is {more}")
    if unclear:
        parts.append(f"not told apart on this path {'is' if len(unclear) == 1 else 'are'} {named(unclear)}")
    return "; ".join(parts) + _bold(block, [name for _, name in ranked])


def _unclear(one: Standing, digits: int) -> str:
    found = one.difference
    more = f", {interval(found, digits)} m more" if found is not None and found.known else ""
    return f"{one.name} ({one.value:.{digits}f} m{more})"


def _best(alike: Sequence[Standing], digits: int, *, alone: bool) -> str:
    """The best, and those that are as good; ``alone`` says whether all others are known to be worse."""
    values = named(list(dict.fromkeys(f"{one.value:.{digits}f}" for one in alike)))
    names = named([one.name for one in alike])
    if len(alike) > 1:
        return f"{names} agree, {values} m, {'neither' if len(alike) == 2 else 'none'} is better"
    return f"{names} is best, {values} m" if alone else f"{names} has {values} m"


def _bold(block: Block, names: Sequence[str]) -> str:
    """Name those that are overconfident, by how much their sigmas are too small."""
    told: dict[str, list[str]] = {}
    for name in names:
        found = block.consistency_of(name)
        if found is not None and found.word == "overconfident":
            small = f"{times(found.gap)} times" if found.sigmas and found.gap else ""
            told.setdefault(small, []).append(name)
    if not told:
        return ""
    sigmas = " (sigmas too small)" if any(told) else ""
    said = [f"{named(some)} {small}".strip() for small, some in told.items()]
    return f"; overconfident{sigmas}: {', '.join(said)}"


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
