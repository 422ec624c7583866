"""Lines on trajectories from elsewhere: how they were read, and what would fool their scores."""

from collections.abc import Mapping

from vislam.core.own_clock import OwnClock


def read_lines(own: Mapping[str, OwnClock]) -> list[str]:
    """How each was read and matched, with what was mended and left out, a line each."""
    lines = []
    for name, one in own.items():
        counts = [f"{value} {key.replace('_', ' ')}" for key, value in one.run.log.counts.items() if value]
        lines.append(f"{name}: {'; '.join((*one.told, *counts))}")
    return lines


def noticed_lines(own: Mapping[str, OwnClock]) -> list[str]:
    """Conventions that would fool the scores, each with the option that answers it."""
    return [f"Noticed: {name}: {text}" for name, one in own.items() for text in one.noticed]
