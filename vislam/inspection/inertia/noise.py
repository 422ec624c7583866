"""Noise of raw inertia: by its Allan deviation where it is at rest, else by what it is off the tracks."""

from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array
from vislam.core.imu import ImuSeries
from vislam.core.integrals import covered
from vislam.core.sequence import Sequence
from vislam.core.still import still_frames, stops
from vislam.initialisation import InitialisationSettings, NotFoundError
from vislam.initialisation.alignment import align
from vislam.initialisation.noise import factor_over
from vislam.initialisation.plausible import check_gravity
from vislam.initialisation.refinement import refine
from vislam.initialisation.window import window_of
from vislam.inspection.finding import Finding, Measured
from vislam.inspection.inertia.allan import Allan, allan
from vislam.models.imu import ImuNoise

CHECK = "imu noise"
_STILL_S = 10.0
"""Of a standstill whose Allan deviation is taken."""
_SKIPPED = 1.5
"""Usual periods; the Allan deviation takes samples for evenly spaced."""
_WINDOWS = 3
"""Parts of a recording over which samples and tracks are held against each other, as at its beginning."""
_FEWEST_STEPS = 4
_REDUNDANCY, _SURE = 6, 3.0
"""Of a step that is told; standard deviations by which a sum of squares is too large to be chance."""
_FACTOR = 2.0
"""White noise that is too small, or too large, by more is a fault."""
_REFUTED = 5.0
"""Samples that are quieter, or noisier, by this factor than configured refute it."""
_EVEN, _FEWEST_DIFFERENCES = 0.1, 100
"""Share of a period by which evenly spaced samples differ; differences of such that are needed."""
_FOURTH = np.sqrt(70.0)
"""Standard deviation of a fourth difference of white noise of variance 1."""
_DENSITIES = ("gyro_density", "accel_density", "gyro_walk", "accel_walk")
_UNITS = dict(
    zip(_DENSITIES, ("rad/s/sqrt(Hz)", "m/s^2/sqrt(Hz)", "rad/s/sqrt(s)", "m/s^2/sqrt(s)"), strict=True)
)


@dataclass(frozen=True)
class _Rest:
    """What a standstill tells.

    Attributes
    ----------
    seconds : float
        How long it is.
    gyro, accel : Allan
    """

    seconds: float
    gyro: Allan
    accel: Allan


def check_noise(sequence: Sequence, noise: ImuNoise) -> Finding:
    """Densities of white noise, and random walks where a standstill tells them, against those configured.

    At rest a sensor has the noise of its data sheet. A body that moves adds to it, so that what samples are
    off the tracks comes on top.

    Parameters
    ----------
    sequence : Sequence
        In SI units, mounted and timed as it is to be used.
    noise : ImuNoise
        As configured.
    """
    assert sequence.imu is not None
    rest = _at_rest(sequence)
    base = _not_refuted(noise, sequence.imu) if rest is None else _of_rest(noise, rest)
    factors = _factors(sequence, base)
    if rest is None and not factors:
        text = (
            f"not told: never at rest for {_STILL_S:g} s, and no part in which tracks and samples are aligned"
        )
        return Finding(CHECK, "unclear", text, unknown=dict.fromkeys(_paths(), f"{text}; as configured"))
    found = _measured(base, rest, factors or [1.0])
    text = "; ".join(f"{one}, configured is {getattr(noise, name):g}" for name, one in found.items())
    text = f"{text}; {_how(rest, factors, sequence.imu)}"
    values = {f"noise.imu.{name}": float(f"{one.value:.3g}") for name, one in found.items()}
    unknown = {
        path: "no standstill that is long enough to tell it; as configured"
        for path in _paths()
        if path not in values
    }
    off = [name for name, one in found.items() if _off(one, getattr(noise, name), _sure(factors))]
    if off:
        text = f"{' and '.join(name.replace('_', ' ') for name in off)} configured otherwise: {text}"
        return Finding(CHECK, "fault", text, tuple(found.values()), proposal=values, unknown=unknown)
    return Finding(CHECK, "ok", text, tuple(found.values()), settings=values, unknown=unknown)


def _measured(base: ImuNoise, rest: _Rest | None, factors: list[float]) -> dict[str, Measured]:
    """Densities, and the walks that a standstill shows, by name."""
    middle, low, high = float(np.median(factors)), min(factors), max(factors)
    found = {}
    for name, one in zip(_DENSITIES, (None, None) if rest is None else (rest.gyro, rest.accel), strict=False):
        value = float(getattr(base, name))
        spread = 0.0 if one is None else 1.96 * one.sigma
        found[name] = Measured(
            name.replace("_", " "),
            _UNITS[name],
            middle * value,
            low * (value - spread),
            high * (value + spread),
        )
    if rest is not None:
        for name, one in (("gyro_walk", rest.gyro), ("accel_walk", rest.accel)):
            if one.walks:
                # To a factor of two: a few of the longest clusters tell it.
                found[name] = Measured(
                    name.replace("_", " "), _UNITS[name], one.walk, 0.5 * one.walk, 2.0 * one.walk
                )
    return found


def _how(rest: _Rest | None, factors: list[float], series: ImuSeries) -> str:
    """How the levels were found."""
    parts = []
    if rest is not None:
        parts.append(
            f"Allan deviation over {rest.seconds:.0f} s at rest: {rest.gyro.density:.3g} "
            f"{_UNITS['gyro_density']}, {rest.accel.density:.3g} {_UNITS['accel_density']}"
        )
    elif most := sample_densities(series):
        parts.append(
            f"differences of the samples: at most {most['gyro_density']:.2g} {_UNITS['gyro_density']}, "
            f"{most['accel_density']:.2g} {_UNITS['accel_density']}"
        )
    if factors:
        parts.append(
            f"off the tracks by {np.median(factors):.2g} times that which is "
            f"{'measured at rest' if rest is not None else 'taken for right'}, over {len(factors)} parts "
            f"{min(factors):.2g} to {max(factors):.2g}"
        )
    else:
        parts.append("not held against the tracks, which tell no first state")
    return "; ".join(parts)


def _sure(factors: list[float]) -> float:
    """Share of the level of which half of the parts, or more, say that it is no less."""
    return sorted(factors)[(len(factors) - 1) // 2] / float(np.median(factors)) if factors else 0.0


def _off(found: Measured, configured: float, sure: float) -> bool:
    """Whether a level is configured outside of its interval, as less than half or more than twice of it.

    One part that says little does not hold a level that most of them refute as too small.
    """
    small = configured < min(max(found.low, sure * found.value), found.value / _FACTOR)
    return small or configured > max(found.high, found.value * _FACTOR)


def _paths() -> list[str]:
    return [f"noise.imu.{name}" for name in _DENSITIES]


def _at_rest(sequence: Sequence) -> _Rest | None:
    """Allan deviation of the longest standstill; None where that is too short."""
    series = sequence.imu
    assert series is not None
    dt = np.diff(sequence.stamp, prepend=sequence.stamp[0])
    runs = [_ends(sequence, run) for run in stops(still_frames(sequence), dt, shortest=_STILL_S)]
    runs = [ends for ends in runs if covered(series, *ends, longest=_SKIPPED * series.period)[0]]
    if not runs:
        return None
    begin, end = (float(one[0]) for one in max(runs, key=_length))
    inside = (series.stamp >= begin) & (series.stamp <= end)
    gyro, accel = (allan(values[inside], period=series.period) for values in (series.gyro, series.accel))
    # Samples that do not change at all come from no sensor.
    return None if min(gyro.density, accel.density) <= 0.0 else _Rest(end - begin, gyro, accel)


def _of_rest(noise: ImuNoise, rest: _Rest) -> ImuNoise:
    """Noise with the densities of a standstill."""
    return replace(noise, gyro_density=rest.gyro.density, accel_density=rest.accel.density)


def _not_refuted(noise: ImuNoise, series: ImuSeries) -> ImuNoise:
    """Noise with the densities that the samples show, where these refute what is configured."""
    refuted = {
        name: shown
        for name, shown in sample_densities(series).items()
        if shown > 0.0 and abs(np.log(shown / getattr(noise, name))) > np.log(_REFUTED)
    }
    return replace(noise, **refuted)


def _ends(sequence: Sequence, run: slice) -> tuple[Array, Array]:
    """Ends ``(1,)`` of a run of still frames, on the clock of the samples [s]."""
    begin, end = sequence.stamp[max(run.start - 1, 0)], sequence.stamp[run.stop - 1]
    return np.array([begin + sequence.clock_offset]), np.array([end + sequence.clock_offset])


def _length(ends: tuple[Array, Array]) -> float:
    return float(ends[1][0] - ends[0][0])


def _factors(sequence: Sequence, noise: ImuNoise) -> list[float]:
    """Factors of the densities over parts of a recording in which tracks and samples are aligned."""
    settings = InitialisationSettings()
    stamp, longest = sequence.stamp, settings.windows[-1]
    begins = np.linspace(stamp[0], max(stamp[-1] - longest, stamp[0]), _WINDOWS)
    found = []
    for begin in np.unique(np.searchsorted(stamp, begins)):
        part = sequence.part(int(begin), len(sequence))
        window = window_of(part, seconds=longest, most=settings.most_frames, step=settings.step)
        told = np.count_nonzero(window.told)
        if told < max(_FEWEST_STEPS, settings.covered * len(window)) or window.covered < settings.covered:
            continue
        aligned = align(window, noise)
        try:
            check_gravity(aligned, noise)
        except NotFoundError:
            continue
        # Half of all recordings whose noise is right have residuals that are a little too large.
        scatter = np.sqrt(2.0 / (_REDUNDANCY * told))
        ratio = refine(window, aligned, noise, settings).variance_factor
        found.append(factor_over(window, noise, settings) if ratio > 1.0 + _SURE * scatter else 1.0)
    return found


def sample_densities(series: ImuSeries) -> dict[str, float]:
    """White noise that samples of a smooth motion have at most, by their fourth differences, by its name.

    Of evenly spaced samples; empty where too few are.
    """
    step = np.diff(series.stamp)
    even = np.abs(step - series.period) < _EVEN * series.period
    whole = np.lib.stride_tricks.sliding_window_view(even, 4).all(axis=1) if len(even) > 3 else even[:0]
    if np.count_nonzero(whole) < _FEWEST_DIFFERENCES:
        return {}
    out = {}
    for name, values in (("gyro_density", series.gyro), ("accel_density", series.accel)):
        fourth = np.diff(values, n=4, axis=0)[whole] / _FOURTH
        out[name] = float(1.4826 * np.median(np.abs(fourth)) * np.sqrt(series.period))
    return out
