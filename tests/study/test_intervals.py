"""Intervals hold the truth as often as they say."""

import numpy as np
import pytest

from vislam.study.intervals import bootstrap, positive_mean, share

TRIALS = 400


def held(interval, draw, truth):
    """Share of the intervals that hold the truth."""
    found = [interval(draw()) for _ in range(TRIALS)]
    return np.mean([one.low <= truth <= one.high for one in found])


def test_the_interval_of_a_share_is_the_published_one():
    # Newcombe, Two-sided confidence intervals for the single proportion (Statistics in Medicine 1998),
    # table I, method 3.
    for hits, count, low, high in (
        (81, 263, 0.2553, 0.3662),
        (15, 148, 0.0624, 0.1605),
        (0, 20, 0.0, 0.1611),
        (1, 29, 0.0061, 0.1718),
    ):
        found = share(hits, count)
        assert (round(found.low, 4), round(found.high, 4)) == (low, high)
    assert share(7, 7).high == 1.0


# 400 intervals of 95 %: 92 to 98 % hold with four standard deviations to spare below, three above.
@pytest.mark.statistical
def test_the_interval_of_a_mean_holds_it_as_often_as_it_says(rng):
    assert 0.92 <= held(positive_mean, lambda: rng.gamma(9.0, 1.0, 8), 9.0) <= 0.985
    assert 0.91 <= held(positive_mean, lambda: rng.chisquare(6, 30) / 6, 1.0) <= 0.985


@pytest.mark.statistical
@pytest.mark.parametrize(("statistic", "truth"), [(np.mean, 1.5), (np.median, 3.0 * np.log(2) / 2)])
def test_the_bootstrap_interval_holds_the_truth_of_skewed_errors(rng, statistic, truth):
    covered = held(lambda x: bootstrap(x, statistic), lambda: rng.exponential(1.5, 25), truth)
    assert 0.89 <= covered <= 0.985


@pytest.mark.statistical
def test_the_bootstrap_interval_of_few_trials_is_not_too_short(rng):
    assert held(lambda x: bootstrap(x, np.mean), lambda: rng.normal(size=6), 0.0) >= 0.91


@pytest.mark.parametrize("values", [[0.1, 0.2, 240.0], [0.0, 0.0, 0.0, 5.0], [1.0, 1.0]])
def test_the_interval_of_what_is_not_negative_is_not_negative(values):
    found = positive_mean(np.array(values))
    assert 0.0 < found.low <= found.value <= found.high
    scaled = positive_mean(7.0 * np.array(values))
    assert (scaled.low, scaled.high) == pytest.approx((7.0 * found.low, 7.0 * found.high))


def test_the_same_trials_give_the_same_interval(rng):
    values = rng.normal(size=9)
    assert bootstrap(values, np.mean) == bootstrap(values, np.mean)


@pytest.mark.parametrize("interval", [positive_mean, lambda values: bootstrap(values, np.median)])
def test_missing_values_are_left_out_and_counted(interval, rng):
    values = rng.gamma(4.0, size=10)
    with_gaps = np.concatenate([[np.nan], values, [np.nan, np.inf]])
    whole, found = interval(values), interval(with_gaps)
    assert (found.value, found.low, found.high) == (whole.value, whole.low, whole.high)
    assert (found.count, found.missing) == (10, 3)
    assert interval(np.full(3, np.nan)) is None
    single = interval(np.array([2.0, np.nan]))
    assert single.value == 2.0
    assert np.isnan([single.low, single.high]).all()
