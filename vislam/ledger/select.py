"""Which entries of the ledger are wanted, and in which order."""

import re
from collections.abc import Callable, Sequence

from vislam.base.errors import ConfigError
from vislam.base.legible import quoted
from vislam.ledger.entries import HEADLINES, Entry

_COMPARED: dict[str, Callable[[float, float], bool]] = {
    "<=": lambda one, other: one <= other,
    ">=": lambda one, other: one >= other,
    "<": lambda one, other: one < other,
    ">": lambda one, other: one > other,
}
_TEXTS: dict[str, Callable[[Entry], str]] = {
    "kind": lambda entry: entry.kind,
    "config": lambda entry: entry.name,
    "data": lambda entry: entry.data,
    "when": lambda entry: entry.when.strftime("%Y-%m-%d %H:%M"),
    "commit": lambda entry: entry.commit,
    "code": lambda entry: entry.provenance.get("code", ""),
    "folder": lambda entry: str(entry.folder),
    "estimators": lambda entry: ",".join(entry.estimators),
}
KEYS = (*_TEXTS, "checks", "<estimator>.<metric>", *HEADLINES)
"""What entries can be filtered and sorted by; a headline alone is that of the best run."""


def value(entry: Entry, key: str) -> str | float | None:
    """What an entry has under a key; None if it has nothing.

    Raises
    ------
    ConfigError
        If there is no such key.
    """
    if key in _TEXTS:
        return _TEXTS[key](entry)
    if key == "checks":
        return entry.checks[0] / entry.checks[1] if entry.checks[1] else None
    if key in HEADLINES:
        found = [one for name in entry.estimators if (one := entry.headline(name, key)) is not None]
        return min(found, default=None)
    if "." not in key:
        raise ConfigError(f"{quoted(key)}: no such key; there are {', '.join(KEYS)}")
    estimator, _, metric = key.partition(".")
    return entry.metrics.get(key, entry.metric(estimator, metric))


def select(entries: Sequence[Entry], conditions: Sequence[str]) -> list[Entry]:
    """Entries that meet all conditions ``KEY=TEXT``, ``KEY!=TEXT``, ``KEY<NUMBER`` or ``KEY>NUMBER``.

    Texts are compared as wholes, ``estimators`` one by one.
    """
    tests = [_test(condition) for condition in conditions]
    return [entry for entry in entries if all(test(entry) for test in tests)]


def _test(condition: str) -> Callable[[Entry], bool]:
    found = re.fullmatch(r"([^<>=!]+)(!=|<=|>=|<|>|=)(.*)", condition)
    if found is None:
        raise ConfigError(
            f"--where {quoted(condition)}: expected KEY=TEXT, KEY!=TEXT, KEY<NUMBER or KEY>NUMBER"
        )
    key, sign, wanted = (part.strip() for part in found.groups())
    if sign in _COMPARED:
        compare = _COMPARED[sign]
        if key == "when":
            return lambda entry: compare(*_dates(str(value(entry, key)), wanted))
        try:
            number = float(wanted)
        except ValueError:
            raise ConfigError(
                f"--where {quoted(condition)}: expected a number, got {quoted(wanted)}"
            ) from None
        return lambda entry: isinstance(one := value(entry, key), float) and compare(one, number)

    def equal(entry: Entry) -> bool:
        one = entry.estimators if key == "estimators" else (value(entry, key),)
        return (wanted in [f"{item:g}" if isinstance(item, float) else item for item in one]) == (sign == "=")

    return equal


def _dates(one: str, wanted: str) -> tuple[float, float]:
    """Two dates as numbers by the digits that are wanted: a day is compared with a day."""
    digits = [re.sub(r"\D", "", text) for text in (one, wanted)]
    length = len(digits[1])
    return float(digits[0][:length] or 0), float(digits[1] or 0)


def order(entries: Sequence[Entry], key: str, *, descending: bool) -> list[Entry]:
    """Entries by a key; those that have nothing under it come last."""
    values = [(value(entry, key), entry) for entry in entries]
    known = [pair for pair in values if pair[0] is not None]
    known.sort(key=lambda pair: (isinstance(pair[0], str), pair[0]), reverse=descending)
    return [entry for _, entry in known] + [entry for one, entry in values if one is None]
