"""Averages of correlated chi-square samples: false alarms at most as often as stated, wrong claims found."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import binom, chi2

from vislam.evaluation.statistics import (
    LAGS,
    Statistic,
    effective_errors,
    effective_squares,
    of_errors,
    of_squares,
    whiteness,
)

SAMPLES = 500
TRIALS = 1000


def decaying(length, size):
    """Draws errors of unit variance whose correlation decays by 1/e over a length."""
    factor = np.exp(-1.0 / length)

    def draw(rng):
        noise = rng.normal(size=(SAMPLES, size))
        noise[1:] *= np.sqrt(1.0 - factor**2)
        return lfilter([1.0], [1.0, -factor], noise, axis=0)

    return draw


def walking(size):
    """Draws random walks over their standard deviations, as the errors of dead reckoning are."""

    def draw(rng):
        return (
            np.cumsum(rng.normal(size=(SAMPLES, size)), axis=0)
            / np.sqrt(np.arange(1.0, SAMPLES + 1))[:, None]
        )

    return draw


def integrated(rng):
    """Position and rate of a walk that is integrated once more, whitened by their exact joint covariances."""
    k = np.arange(1.0, SAMPLES + 1)
    rate = np.cumsum(rng.normal(size=(SAMPLES, 3)), axis=0)
    place = np.cumsum(rate, axis=0)
    cov = np.empty((SAMPLES, 2, 2))
    cov[:, 0, 0] = k
    cov[:, 0, 1] = cov[:, 1, 0] = k * (k + 1.0) / 2.0
    cov[:, 1, 1] = k * (k + 1.0) * (2.0 * k + 1.0) / 6.0
    # The first covariance is singular: place and rate are one.
    both = np.stack([rate, place], axis=1)[1:]
    return np.linalg.solve(np.linalg.cholesky(cov[1:]), both).reshape(SAMPLES - 1, 6)


SOUND = {
    "white": (lambda rng: rng.normal(size=(SAMPLES, 3))),
    "length 1": decaying(1.0, 3),
    "length 10": decaying(10.0, 3),
    "length 10, pose": decaying(10.0, 6),
    "length 50": decaying(50.0, 3),
    "length 50, pose": decaying(50.0, 6),
    "walk, one component": walking(1),
    "walk, planar": walking(2),
    "walk": walking(3),
    "walk, pose": walking(6),
    "integrated": integrated,
}


def statistic(whitened):
    return of_errors("nees", whitened, convention="")


@pytest.mark.statistical
@pytest.mark.parametrize("kind", SOUND)
def test_a_sound_estimator_is_accused_no_more_often_than_stated(rng, kind):
    found = np.array([statistic(SOUND[kind](rng)).p_value() for _ in range(TRIALS)])
    for nominal in (0.01, 0.05):
        # As many alarms as a test of exactly this rate has with probability 0.999 at most.
        assert np.sum(found < nominal) <= binom.ppf(0.999, TRIALS, nominal)


@pytest.mark.statistical
def test_taking_the_samples_for_independent_would_accuse_sound_estimators(rng):
    draws = [decaying(10.0, 3)(rng) for _ in range(TRIALS)]
    naive = [Statistic("nees", np.mean(draw**2), 3.0, SAMPLES, SAMPLES, "").p_value() for draw in draws]
    assert np.mean(np.array(naive) < 0.01) > 0.3


@pytest.mark.statistical
@pytest.mark.parametrize("factor", [0.5, 2.0])
@pytest.mark.parametrize("kind", ["length 1", "length 10", "length 10, pose"])
def test_noise_that_is_wrong_by_two_is_found(rng, kind, factor):
    found = np.array([statistic(factor * SOUND[kind](rng)).p_value() for _ in range(200)])
    # The test is cautious with claims of too little.
    assert np.mean(found < 1e-3) > (0.8 if factor < 1.0 else 0.95)


@pytest.mark.parametrize("length", [1.0, 5.0, 10.0])
def test_the_effective_number_is_that_of_the_sum_of_the_autocorrelations(rng, length):
    factor = np.exp(-1.0 / length)
    expected = SAMPLES * (1.0 - factor) / (1.0 + factor)
    found = np.median([effective_errors(decaying(length, 6)(rng)) for _ in range(50)])
    assert 0.7 * expected < found < 1.1 * expected


def test_white_errors_count_nearly_each_and_never_more_than_once(rng):
    found = [effective_errors(rng.normal(size=(SAMPLES, 3))) for _ in range(100)]
    assert np.median(found) > 0.7 * SAMPLES
    # Errors that change their sign each time would count more than once.
    found.append(effective_errors(rng.normal(size=(SAMPLES, 1)) * (-1.0) ** np.arange(SAMPLES)[:, None]))
    swinging = (-1.0) ** np.arange(SAMPLES)[:, None] * np.ones((1, 3))
    found.append(effective_errors(swinging))
    assert max(found) <= SAMPLES


def test_an_error_that_stays_counts_once():
    error = np.tile([1.0, -2.0, 3.0], (SAMPLES, 1))
    found = statistic(error)
    assert found.effective == 1.0
    assert found.p_value() == pytest.approx(2.0 * chi2.sf(14.0, 3))


def test_a_wrong_scale_does_not_change_the_effective_number(rng):
    errors = decaying(10.0, 3)(rng)
    assert effective_errors(7.0 * errors) == pytest.approx(effective_errors(errors))


@pytest.mark.parametrize("probability", [0.8, 0.99])
def test_the_ends_of_the_interval_are_as_probable_as_it_says(probability):
    low, high = Statistic("nees", 1.0, 6.0, 500, 20.0, "").interval(probability)
    assert low < 1.0 < high
    for value in (low, high):
        found = Statistic("nees", value, 6.0, 500, 20.0, "").p_value()
        assert found == pytest.approx(1.0 - probability)


def test_errors_that_were_fitted_accuse_only_if_they_are_large():
    low = Statistic("nees", 0.01, 6.0, 500, 20.0, "", fitted=True)
    assert low.p_value() > 0.999
    assert Statistic("nees", 0.01, 6.0, 500, 20.0, "").p_value() < 1e-6
    floor, high = low.interval(0.99)
    assert floor == 0.0
    assert Statistic("nees", high, 6.0, 500, 20.0, "", fitted=True).p_value() == pytest.approx(0.01)


def squares(rng, length):
    """NIS of frames with differing degrees of freedom; innovations correlated over a length, if above 0."""
    freedom = rng.integers(20, 200, SAMPLES).astype(float)
    normal = decaying(length, 1)(rng)[:, 0] if length else rng.normal(size=SAMPLES)
    # By the cube root of Wilson and Hilferty, with the correlation of the normal numbers.
    part = 2.0 / (9.0 * freedom)
    return freedom * (1.0 - part + normal * np.sqrt(part)) ** 3, freedom


@pytest.mark.statistical
@pytest.mark.parametrize("length", [0, 1, 10])
def test_squares_alone_accuse_no_more_often_than_stated(rng, length):
    found = [of_squares("nis", *squares(rng, length), convention="").p_value() for _ in range(TRIALS)]
    for nominal in (0.01, 0.05):
        assert np.sum(np.array(found) < nominal) <= binom.ppf(0.999, TRIALS, nominal)


def test_squares_alone_find_noise_that_is_wrong_by_a_tenth(rng):
    nis, freedom = squares(rng, 0)
    assert of_squares("nis", nis, freedom, convention="").p_value() > 1e-3
    assert of_squares("nis", 1.21 * nis, freedom, convention="").p_value() < 1e-3
    assert effective_squares(1.21 * nis, freedom) == pytest.approx(effective_squares(nis, freedom))


def test_a_white_sequence_is_white_and_a_smoothed_one_is_not(rng):
    found = [whiteness(*squares(rng, 0)) for _ in range(200)]
    assert 0.9 < np.mean([np.abs(one.autocorrelation) < one.band for one in found]) < 0.99
    assert 0.01 < np.mean([one.p_value < 0.05 for one in found]) < 0.1
    nis, freedom = squares(rng, 0)
    smoothed = whiteness(0.5 * (nis[1:] + nis[:-1] * freedom[1:] / freedom[:-1]), freedom[1:])
    assert smoothed.p_value < 1e-3
    assert smoothed.autocorrelation[0] > 4.0 * smoothed.band
    assert np.array_equal(smoothed.lag, np.arange(1, LAGS + 1))


def test_few_samples_have_no_whiteness(rng):
    nis, freedom = squares(rng, 0)
    assert whiteness(nis[: 2 * LAGS], freedom[: 2 * LAGS]) is None


def test_a_single_error_is_one_sample():
    assert effective_errors(np.ones((1, 6))) == 1.0
