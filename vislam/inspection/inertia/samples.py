"""The samples by themselves: missing, duplicated and irregular ones, and those that are stuck."""

import numpy as np

from vislam.base.types import Array
from vislam.core.imu import ImuSeries
from vislam.inspection.finding import Finding

_MISSING = 1.5
"""A step of so many usual ones has a sample missing."""
_SHARE = 0.005
"""Share of samples, missing or duplicated, above which it is a fault."""
_JITTER = 0.1
"""Spread of the steps, in usual ones, above which stamps are irregular: an interval's length is then wrong by
so much."""
_STUCK, _TIMES, _NEXT = 6, 5, 10
"""A value at an extreme is a stop of the sensor's range if so many samples have it, and so many times as many
as any of the next values."""
_NAMES = ("gyro x", "gyro y", "gyro z", "accelerometer x", "accelerometer y", "accelerometer z")


def check_samples(series: ImuSeries, *, covered: float) -> Finding:
    """Samples that are missing, came twice, or stand at irregular times.

    Parameters
    ----------
    series : ImuSeries
    covered : float
        Share of the recording that lies within it.
    """
    step, usual = np.diff(series.stamp), series.period
    skipped = step > _MISSING * usual
    # Irregular stamps look like steps that are skipped; over all, none is.
    whole = round(float(series.stamp[-1] - series.stamp[0]) / usual) + 1 - len(series)
    missing = max(min(int(np.round(step[skipped] / usual - 1.0).sum()), whole), 0)
    jitter = 1.4826 * float(np.median(np.abs(step[~skipped] - usual))) / usual
    counts = {
        "samples": len(series),
        "rate_hz": 1.0 / usual,
        "missing": missing,
        "longest_step_s": float(step.max()),
        "duplicates": series.duplicates,
        "jitter": jitter,
        "covered": covered,
    }
    every = len(series) + missing
    text = (
        f"{len(series)} samples at {1.0 / usual:.4g} Hz, {missing} missing ({missing / every:.1%}), longest "
        f"step {step.max():.3g} s, {series.duplicates} duplicated or out of order, steps spread by "
        f"{jitter:.1%}, {covered:.1%} of the recording covered"
    )
    reasons = []
    if missing > _SHARE * every:
        reasons.append(
            f"{missing / every:.1%} of the samples are missing: short gaps are bridged by a line, longer "
            "ones by an uncertain motion; look at the recorder"
        )
    if series.duplicates > _SHARE * every:
        reasons.append(f"{series.duplicates} samples are no later than those before and are dropped")
    if jitter > _JITTER:
        reasons.append(
            f"stamps are irregular, their steps spread by {jitter:.0%}: use the sensor's own clock, not the "
            "time of arrival"
        )
    if covered < 1.0 - _SHARE:
        reasons.append(f"{1.0 - covered:.1%} of the recording has no samples")
    text = f"{'; '.join(reasons)}: {text}" if reasons else text
    return Finding("imu samples", "fault" if reasons else "ok", text, counts=counts)


def check_saturation(series: ImuSeries) -> Finding:
    """Samples that are stuck at one extreme, as those beyond the range of a sensor are."""
    found: list[str] = []
    counts: dict[str, float] = {}
    for name, axis in zip(_NAMES, np.hstack([series.gyro, series.accel]).T, strict=True):
        if np.ptp(axis) == 0.0:
            found.append(f"{name} is {axis[0]:.4g} throughout: it measures nothing")
            counts[f"{name} stuck"] = len(axis)
            continue
        for value, many in _stops(axis):
            found.append(f"{many} samples of {name} are stuck at {value:.4g}")
            counts[f"{name} stuck"] = counts.get(f"{name} stuck", 0) + many
    largest = [float(np.abs(part).max()) for part in (series.gyro, series.accel)]
    text = f"largest rate {largest[0]:.3g} rad/s, largest specific force {largest[1]:.3g} m/s^2"
    if found:
        text = (
            f"{'; '.join(found)}: where motion goes beyond the range no noise covers the error, use the "
            "wider range of the sensor or leave that part out"
        )
        return Finding("imu saturation", "fault", text, counts=counts)
    return Finding("imu saturation", "ok", f"no sample is stuck at an extreme; {text}", counts=counts)


def _stops(axis: Array) -> list[tuple[float, int]]:
    """Extremes of an axis ``(n,)`` that are a stop, each with the number of samples that have it."""
    values, many = np.unique(axis, return_counts=True)
    sides = ((values, many), (values[::-1], many[::-1]))
    return [
        (float(value[0]), int(count[0]))
        for value, count in sides
        if count[0] >= _STUCK and count[0] > _TIMES * max(count[1 : 1 + _NEXT], default=0)
    ]
