"""The named shapes of a path: heading and speed of the point that moves straight ahead."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.simulation.settings import SimulationConfig

_BESSEL_ZERO = 2.404825557695773
"""First zero of the Bessel function J0."""
_HELIX_TURNS = 3.0
_HELIX_GRADE = 0.06
_HALF_TURN_TIME = 2.0
"""Half the time that a right-angle turn takes [s]."""
_CORNER_PACE = 0.4
"""Pace in a right-angle turn, as a share of that between corners."""
_AT_ONCE = 1_000_000
"""Times by corners that are computed at once."""


@dataclass(frozen=True)
class Shape:
    """Motion of the vehicle in the plane.

    Attributes
    ----------
    heading : callable
        Heading ``(n,)`` [rad] at times ``(n,)`` [s].
    pace : callable
        Speed ``(n,)`` at times ``(n,)``, as a share of the configured one.
    grade : float
        Constant slope under the hills.
    by_way : bool
        Whether hills and sway come with the way driven, so that a body at rest is at rest; otherwise they
        come with time.
    """

    heading: Callable[[Array], Array]
    pace: Callable[[Array], Array]
    grade: float = 0.0
    by_way: bool = True


def shape(config: SimulationConfig, phases: Array, generator: np.random.Generator) -> Shape:
    """Shape that a config names; ``phases (8,)`` [rad] are those of its waves."""
    duration = config.frames * config.period
    if config.path == "urban":
        return _urban(duration, generator)
    if config.path == "figure_eight":
        return _figure_eight(duration)
    if config.path == "highway":
        return _highway(phases)
    if config.path == "helix":
        rate = 2.0 * np.pi * _HELIX_TURNS / duration
        return Shape(lambda time: np.asarray(rate * time), np.ones_like, grade=_HELIX_GRADE)
    if config.path in ("loop", "circuit"):
        return _round(config, duration, phases)
    return _town(config.path == "town", duration, phases, generator)


def _round(config: SimulationConfig, duration: float, phases: Array) -> Shape:
    """Once round a circle at an uneven speed, or several times at a constant one."""
    if config.path == "circuit":
        return Shape(_circle(duration / config.laps), np.ones_like)
    return Shape(_circle(duration), lambda time: _uneven(time, phases), by_way=False)


def _circle(duration: float) -> Callable[[Array], Array]:
    return lambda time: np.asarray(2.0 * np.pi * time / duration)


def _uneven(time: Array, phases: Array) -> Array:
    return np.asarray(1.0 + 0.15 * np.sin(0.31 * time + phases[2]) + 0.08 * np.sin(0.83 * time + phases[3]))


def _town(turning: bool, duration: float, phases: Array, generator: np.random.Generator) -> Shape:
    """Wander along a straight line or, turning, through corners that are taken more slowly."""
    when, angle, width = _town_turns(duration, generator) if turning else np.empty((3, 0))

    def heading(time: Array) -> Array:
        wave = 0.04 * np.sin(0.23 * time + phases[0]) + 0.02 * np.sin(0.71 * time + phases[1])
        turned = _summed(lambda at: 0.5 * angle * (1.0 + np.tanh((at - when) / width)), time, len(when))
        return np.asarray(wave + turned)

    def pace(time: Array) -> Array:
        loss = 0.35 * np.abs(angle) / 1.5
        slow = _summed(lambda at: loss * np.exp(-(((at - when) / (1.5 * width)) ** 2)), time, len(when))
        return np.asarray(_uneven(time, phases) - np.minimum(slow, 0.6))

    return Shape(heading, pace, by_way=False)


def _summed(corners: Callable[[Array], Array], time: Array, count: int) -> Array:
    """Sum ``(n,)`` of what all corners do at times ``(n,)``.

    Some times after the other: a path through a town has a corner every 13 s, so that all at once take
    memory with the square of its duration.

    Parameters
    ----------
    corners : callable
        What each does at times ``(k, 1)``, ``(k, count)``.
    time : (n,)
        [s].
    count : int
        Number of the corners.
    """
    size = _AT_ONCE // max(count, 1) + 1
    found = np.empty(len(time))
    for first in range(0, len(time), size):
        found[first : first + size] = corners(time[first : first + size, None]).sum(axis=1)
    return found


def _town_turns(duration: float, generator: np.random.Generator) -> tuple[Array, Array, Array]:
    """Time [s], angle [rad] and width [s] of the corners of a path through a town."""
    times = np.arange(9.0, duration + 10.0, 13.0)
    times = times + generator.uniform(-2.0, 2.0, len(times))
    sign = generator.choice([-1.0, 1.0], len(times))
    angle = sign * generator.uniform(0.3, 1.5, len(times))
    return times, angle, generator.uniform(0.9, 1.5, len(times))


def _urban(duration: float, generator: np.random.Generator) -> Shape:
    """Straight blocks between right-angle turns; before the first, third, ... the body stands for 2.5 s."""
    corners = 12.0 + np.cumsum(generator.uniform(18.0, 26.0, int(duration / 18.0) + 2)) - 18.0
    sign = generator.choice([-1.0, 1.0], len(corners))
    when, angle = [0.0], [0.0]
    at, pace = [-2.0], [1.0]
    for index, corner in enumerate(corners):
        when += [corner - _HALF_TURN_TIME, corner + _HALF_TURN_TIME]
        angle += [angle[-1], angle[-1] + sign[index] * np.pi / 2.0]
        if index % 2 == 0:
            at += [corner - 10.5, corner - 7.0, corner - 4.5]
            pace += [1.0, 0.0, 0.0]
        else:
            at.append(corner - 5.0)
            pace.append(1.0)
        at += [corner - _HALF_TURN_TIME, corner + _HALF_TURN_TIME, corner + 6.0]
        pace += [_CORNER_PACE, _CORNER_PACE, 1.0]
    middle = np.linspace(0.0, duration, int(duration / 0.01) + 2)
    mean = float(_eased(middle, at, pace).mean())
    return Shape(lambda time: _eased(time, when, angle), lambda time: _eased(time, at, pace) / mean)


def _eased(time: Array, knots: list[float], values: list[float]) -> Array:
    """Go from value to value with rate and acceleration of zero at the knots (quintic)."""
    at, value = np.array(knots), np.array(values)
    piece = np.clip(np.searchsorted(at, time), 1, len(at) - 1)
    share = np.clip((time - at[piece - 1]) / (at[piece] - at[piece - 1]), 0.0, 1.0)
    eased = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return np.asarray(value[piece - 1] + (value[piece] - value[piece - 1]) * eased)


def _figure_eight(duration: float) -> Shape:
    """Sine-generated curve (Langbein and Leopold 1966) from its crossing on; it closes, as J0 is zero."""
    rate = 2.0 * np.pi / duration
    return Shape(lambda time: np.asarray(_BESSEL_ZERO * (np.cos(rate * time) - 1.0)), np.ones_like)


def _highway(phases: Array) -> Shape:
    """Curves of at least 2 km radius at 33 m/s, at a nearly even speed."""

    def heading(time: Array) -> Array:
        return np.asarray(0.25 * np.sin(0.04 * time + phases[0]) + 0.05 * np.sin(0.11 * time + phases[1]))

    return Shape(heading, lambda time: np.asarray(1.0 + 0.03 * np.sin(0.09 * time + phases[2])))
