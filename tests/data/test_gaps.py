"""What a straight line over a gap misses: by the walk, white noise and a parabola, and split among frames."""

import numpy as np
import pytest

from vislam.core.gaps import bridged_densities, held_densities
from vislam.core.imu import ImuSeries, ImuStep

PERIOD, GAP = 0.01, 0.2
STAMP = PERIOD * np.arange(20_000)


def walk(rng, density):
    return np.cumsum(density * np.sqrt(PERIOD) * rng.normal(size=(len(STAMP), 1)), axis=0)


def test_of_a_random_walk_a_line_misses_what_a_bridge_does(rng):
    values = walk(rng, 2.0)
    bridged = bridged_densities(STAMP, values, np.array([GAP, 0.5]))
    assert np.allclose(bridged[:, 0], 4.0 * np.square([GAP, 0.5]) / 12.0, rtol=0.25)
    # The error of a mean: what was recorded over the gap less the mean of its ends.
    k = round(GAP / PERIOD)
    windows = np.lib.stride_tricks.sliding_window_view(values[:, 0], k + 1)[::k]
    missed = (windows[:, :-1] + windows[:, 1:]).mean(axis=1) / 2.0 - 0.5 * (windows[:, 0] + windows[:, -1])
    assert GAP * missed.var() == pytest.approx(bridged[0, 0], rel=0.25)
    held = held_densities(STAMP, values, np.array([GAP]))
    ahead = windows.mean(axis=1) - windows[:, 0]
    assert GAP * np.mean(ahead**2) == pytest.approx(held[0, 0], rel=0.25)


def test_of_white_noise_a_line_misses_its_two_ends(rng):
    values = 0.3 * rng.normal(size=(len(STAMP), 1))
    bridged = bridged_densities(STAMP, values, np.array([GAP]))
    assert bridged[0, 0] == pytest.approx(GAP * 0.3**2 / 2.0, rel=0.1)


def test_of_a_parabola_a_line_misses_nearly_its_mean():
    values = STAMP[:500, None] ** 2
    bridged = bridged_densities(STAMP[:500], values, np.array([GAP]))
    # Standard deviations as sqrt(1/3) for 2/3, at a length that is rounded to whole samples.
    assert np.sqrt(bridged[0, 0] / GAP) == pytest.approx(np.sqrt(0.75) * 2.0 * GAP**2 / 12.0, rel=0.1)


def test_few_samples_are_taken_for_white_about_their_mean():
    stamp, values = np.array([0.0, 1.0, 2.0]), np.array([[0.0], [3.0], [0.0]])
    assert bridged_densities(stamp, values, np.array([2.0]))[0, 0] == pytest.approx(1.5 * 4.0 / 12.0 * 4.0)


def test_frames_within_a_gap_share_what_is_missed(rng):
    values = np.hstack([walk(rng, 0.1 * (1 + i)) for i in range(6)])
    kept = np.ones(len(STAMP), bool)
    kept[1001:1024] = False
    series = ImuSeries(STAMP[kept], values[kept, :3], values[kept, 3:])
    frames = np.concatenate([[9.5], 10.0 + np.array([0.02, 0.1, 0.15, 0.3])])
    steps = list(series.steps(frames))
    assert all(not step.missed[step.known].any() for step in steps)
    turned = sum((step.missed * step.dt[:, None] ** 2).sum(axis=0) for step in steps)
    # The mean over the whole gap of 0.24 s has the variance of a bridge, by the worst axis of each sensor.
    assert np.allclose(turned, np.square([0.3, 0.6]) * 0.24**3 / 12.0, rtol=0.3)
    whole = ImuStep.joined(steps[1:])
    assert np.allclose(whole.dt**2 @ whole.missed, sum(step.dt**2 @ step.missed for step in steps[1:]))
    assert not list(series.steps(np.array([1.0, 2.0])))[1].missed.any()


def test_beyond_the_samples_nothing_holds_the_other_end(rng):
    values = np.hstack([walk(rng, 1.0) for _ in range(6)])
    series = ImuSeries(STAMP, values[:, :3], values[:, 3:])
    last = series.stamp[-1]
    *_, step = series.steps(np.array([last - 0.1, last + 0.4]))
    turned = (step.missed * step.dt[:, None] ** 2).sum(axis=0)
    assert np.allclose(turned, 0.4**3 / 3.0, rtol=0.5)
