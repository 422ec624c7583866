"""Samples of an accelerometer and a gyro by themselves: missing, irregular, stuck; the Allan deviation."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.core.imu import ImuSeries
from vislam.core.integrals import Integral
from vislam.inspection.inertia.allan import allan
from vislam.inspection.inertia.samples import check_samples, check_saturation

RATE = 200.0


def series(count=4000, *, seed=0, stamp=None):
    generator = np.random.default_rng(seed)
    stamp = np.arange(count) / RATE if stamp is None else stamp
    return ImuSeries.of(
        stamp, 0.1 * generator.standard_normal((count, 3)), generator.standard_normal((count, 3))
    )


def test_even_samples_are_right():
    found = check_samples(series(), covered=1.0)
    assert (found.verdict, found.counts["missing"], found.counts["duplicates"]) == ("ok", 0, 0)


def test_dropped_samples_are_counted():
    whole = series()
    kept = np.random.default_rng(1).random(len(whole)) > 0.05
    found = check_samples(ImuSeries(whole.stamp[kept], whole.gyro[kept], whole.accel[kept]), covered=1.0)
    assert found.verdict == "fault"
    # What is missing at the ends cannot be seen.
    assert found.counts["missing"] == pytest.approx(np.count_nonzero(~kept), abs=2)


def test_duplicated_samples_are_counted():
    stamp = np.repeat(np.arange(2000) / RATE, 2)
    found = check_samples(series(stamp=stamp), covered=1.0)
    assert (found.verdict, found.counts["duplicates"]) == ("fault", 2000)


def test_irregular_stamps_are_no_missing_samples():
    generator = np.random.default_rng(2)
    stamp = (np.arange(4000) + generator.uniform(-0.35, 0.35, 4000)) / RATE
    found = check_samples(series(stamp=stamp), covered=1.0)
    assert found.verdict == "fault"
    assert "irregular" in found.text
    assert "missing:" not in found.text


def test_a_recording_that_samples_do_not_cover_is_a_fault():
    assert check_samples(series(), covered=0.9).verdict == "fault"


def test_samples_at_the_end_of_a_range_are_found_and_those_of_a_coarse_sensor_at_rest_are_not():
    whole = series()
    assert check_saturation(whole).verdict == "ok"
    clipped = check_saturation(replace(whole, gyro=np.clip(whole.gyro, -0.2, 0.2)))
    assert clipped.verdict == "fault"
    assert clipped.counts["gyro x stuck"] > 50
    coarse = replace(whole, gyro=0.1 * np.round(whole.gyro / 0.1), accel=0.5 * np.round(whole.accel / 0.5))
    assert check_saturation(coarse).verdict == "ok"


def test_a_dead_axis_is_found():
    whole = series()
    accel = whole.accel.copy()
    accel[:, 1] = 0.0
    found = check_saturation(replace(whole, accel=accel))
    assert found.verdict == "fault"
    assert "accelerometer y" in found.text


def test_integrals_of_straight_lines_are_exact():
    stamp = np.array([0.0, 0.3, 1.0, 1.5])
    found = Integral(stamp, np.column_stack([2.0 * stamp + 1.0, np.ones(4)]))
    time = np.array([0.1, 0.3, 1.2, 1.5])
    np.testing.assert_allclose(found.once(time), np.column_stack([time**2 + time, time]), atol=1e-12)
    np.testing.assert_allclose(
        found.twice(time), np.column_stack([time**3 / 3.0 + time**2 / 2.0, time**2 / 2.0]), atol=1e-12
    )


@pytest.mark.parametrize("shaken", [False, True])
def test_white_noise_is_recovered_beside_a_vibration(shaken):
    count, density = 6000, 2e-3
    generator = np.random.default_rng(3)
    values = density * np.sqrt(RATE) * generator.standard_normal((count, 3))
    if shaken:
        # At 10 Hz, as large as the noise of a sample.
        values += density * np.sqrt(RATE) * np.sin(20.0 * np.pi * np.arange(count) / RATE)[:, None]
    found = allan(values, period=1.0 / RATE)
    assert abs(found.density - density) < 4.0 * found.sigma + 0.1 * density
    assert not found.walks


def test_a_walk_is_recovered():
    count, density, walk = 40000, 1e-3, 2e-3
    generator = np.random.default_rng(4)
    steps = walk / np.sqrt(RATE) * generator.standard_normal((count, 3))
    values = np.cumsum(steps, axis=0) + density * np.sqrt(RATE) * generator.standard_normal((count, 3))
    found = allan(values, period=1.0 / RATE)
    assert found.walks
    assert walk / 2.0 < found.walk < walk * 2.0
    assert found.density == pytest.approx(density, rel=0.2)
