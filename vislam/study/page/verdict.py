"""The verdict of a study, in sentences: failures, accuracy, overconfidence."""

from collections.abc import Sequence

import numpy as np

from vislam.study.answers import FEWEST_TRIALS, PooledNees, failure_rate, median, onset, paired, pooled_nees
from vislam.study.page.labels import (
    ERRORS,
    errors,
    parameter_label,
    percent,
    point_label,
    setting,
    with_interval,
)
from vislam.study.page.limits import against_bound, waiting
from vislam.study.trials import Trials, is_number

_SURE = 0.05
"""p-value under which a difference is more than luck."""


def verdict(trials: Trials) -> list[str]:
    """Sentences, the most important first."""
    if not trials.complete:
        return [_extent(trials), "No run was started, so there is nothing to tell."]
    blocks = [trials.of(estimate) for estimate in trials.estimates]
    told = [_extent(trials), _failures(trials), *(_of(block, _accuracy(block)) for block in blocks)]
    told += [_of(block, consistency(block, name)) for block in blocks for name in block.complete]
    told += [_of(block, sentence) for block in blocks for sentence in against_bound(block)]
    told += waiting(trials)
    return [sentence for sentence in told if sentence]


def _of(block: Trials, sentence: str) -> str:
    """A sentence with the estimate that it is of; nothing if there is none."""
    return f"{str(block.estimate).capitalize()}: {sentence}" if sentence else ""


def _extent(trials: Trials) -> str:
    points = len(trials.groups())
    swept = " and ".join(f"{parameter_label(path)} ({len(trials.levels(path))})" for path in trials.point)
    told = f"{len(trials)} trials" + (f" at {points} points, over {swept}" if swept else "")
    lost = int(np.count_nonzero(~trials.done))
    return f"{told}; {lost} of them failed as a whole." if lost else f"{told}, all of them carried out."


def _failures(trials: Trials) -> str:
    rows = np.arange(len(trials))
    rates = {name: failure_rate(trials, name, rows=rows) for name in trials.complete}
    told = [
        f"{name} {percent(rate)}" for name, rate in rates.items() if rate is not None and rate.value > 0.0
    ]
    return f"Runs that did not finish: {', '.join(told)}." if told else "Every run finished."


def _accuracy(trials: Trials) -> str:
    """State which estimator has the least error, and whether that is significant."""
    if not errors(trials):
        return ""
    key, rows = errors(trials)[0], np.arange(len(trials))
    title, unit = ERRORS[key].short_title, ERRORS[key].unit
    found = {name: median(trials, name, key, rows=rows) for name in trials.complete}
    known = {name: one for name, one in found.items() if one is not None}
    ranked = sorted(known, key=lambda name: known[name].value)
    listed = ", ".join(f"{name} {with_interval(known[name], unit)}" for name in ranked)
    told = f"median {title} over all trials that finished: {listed}"
    pair = paired(trials, ranked[0], ranked[1], key, rows=rows) if len(ranked) > 1 else None
    if pair is None:
        return f"{told}."
    if pair.difference.count < FEWEST_TRIALS:
        few = f"{pair.difference.count} of at least {FEWEST_TRIALS}"
        return f"{told}; too few trials of both to rank them: {few}."
    first, second = ranked[:2]
    if pair.p_value > _SURE:
        return f"{told}; on the same trials {first} and {second} cannot be told apart (p {pair.p_value:.2g})."
    return (
        f"{told}; on the same trials {first} less {second} is {with_interval(pair.difference, unit)}, and "
        f"{first} is better in {percent(pair.better)} (p {pair.p_value:.1g})."
    )


def consistency(trials: Trials, name: str) -> str:
    """State whether, and from which value on, an estimator is overconfident; nothing without data."""
    groups = trials.groups()
    found = [pooled_nees(trials, name, rows=rows) for _, rows in groups]
    labels = [point_label(point) for point, _ in groups]
    known = {label: one for label, one in zip(labels, found, strict=True) if one is not None}
    told = {label: one for label, one in known.items() if one.enough}
    if not told:
        most = max((one.mean.count for one in known.values()), default=0)
        few = f"too few seeds to judge the consistency of {name}: {most} of at least {FEWEST_TRIALS}."
        return few if known else ""
    over = [label for label, one in told.items() if one.overconfident]
    under = [label for label, one in told.items() if one.conservative]
    if not trials.point:
        one = told[labels[0]]
        word = (
            "is overconfident" if over else "is conservative" if under else "is not seen to be inconsistent"
        )
        low, high = one.bounds
        return f"{name} {word}: NEES {with_interval(one.mean)}, {low:.2g} to {high:.2g} expected."
    from_on = _onset(trials, name, found)
    if from_on:
        return from_on
    if over:
        worst = max(over, key=lambda label: told[label].mean.value)
        number = with_interval(told[worst].mean)
        return (
            f"{name} is overconfident at {len(over)} of {len(told)} points, most at {worst}: NEES {number}."
        )
    less = f"; at {len(under)} it is conservative" if under else ""
    return f"{name} is not seen to be overconfident at any of {len(told)} points{less}."


def _onset(trials: Trials, name: str, found: Sequence[PooledNees | None]) -> str:
    """State from which value of the swept parameter on an estimator is overconfident, if from any."""
    path = next(iter(trials.point))
    values, place = trials.levels(path), onset(found)
    if len(trials.point) != 1 or place is None or not all(is_number(value) for value in values):
        return ""
    first = found[place]
    assert first is not None
    lowest = ", the lowest value" if place == 0 else ""
    at = setting(path, values[place])
    return f"{name} is overconfident from {at} on{lowest}: NEES {with_interval(first.mean)}."
