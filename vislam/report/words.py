"""Lists of runs in sentences."""

from collections.abc import Sequence

from vislam.evaluation.difference import ErrorDifference


def listed(ranked: Sequence[tuple[float, str]], digits: int, unit: str) -> str:
    """Names with their values."""
    return ", ".join(f"{name} {value:.{digits}f} {unit}" for value, name in ranked)


def named(names: Sequence[str]) -> str:
    """Names, the last joined by "and"."""
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def times(value: float) -> str:
    """How many times, as finely as anybody reads it."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.1f}"


def plain(value: float) -> str:
    """Three digits of a number, and none behind the point of a large one."""
    return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"


def interval(found: ErrorDifference, digits: int) -> str:
    """Ends of the interval of a difference."""
    # Without the sign of a zero.
    low, high = (round(end, digits) + 0.0 for end in (found.low, found.high))
    return f"{low:.{digits}f} to {high:.{digits}f}"
