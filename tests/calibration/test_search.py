"""The search of the maximum, on likelihoods whose maximum and standard deviations have a closed form."""

import numpy as np
import pytest

from vislam.calibration.search import maximise, without_tails

SAMPLES = 2000
LOWEST = np.log(1e-3)


def normalised(rng, *, mean, sigma, count=SAMPLES):
    """Normal samples of exactly that mean and standard deviation."""
    sample = rng.standard_normal(count)
    return mean + sigma * (sample - sample.mean()) / sample.std()


def normal_density(sample, mean, sigma):
    """Log densities, one a sample, but for a constant."""
    return -0.5 * ((sample - mean) / sigma) ** 2 - np.log(sigma)


def gaussian(sample):
    """Likelihood of points (mean, logarithm of sigma)."""

    def evaluate(points):
        return [normal_density(sample, mean, np.exp(level)) for mean, level in points]

    return evaluate


def added_level(sample):
    """Likelihood of points (logarithm of q): the sample has variance 1 + q^2."""

    def evaluate(points):
        return [normal_density(sample, 0.0, np.sqrt(1.0 + np.exp(2.0 * point[0]))) for point in points]

    return evaluate


def search(evaluate, start, **options):
    count = len(start)
    settings = {
        "steps": np.full(count, 0.03),
        "lowest": np.full(count, -np.inf),
        "largest": np.full(count, 0.7),
        **options,
    }
    return maximise(evaluate, np.array(start), **settings)


def test_mean_and_level_of_a_gaussian_sample(rng):
    sample = normalised(rng, mean=0.4, sigma=2.0)
    found = search(gaussian(sample), [0.0, 0.0], tolerance=1e-3)
    error = np.array([2.0 / np.sqrt(SAMPLES), 1.0 / np.sqrt(2.0 * SAMPLES)])
    # A gain of a thousandth is a distance of 0.05 standard deviations.
    assert np.all(np.abs(found.point - [0.4, np.log(2.0)]) < 0.05 * error)
    # The scores' spread is a sample's: it is known to some per cent.
    assert np.allclose(found.sigma, error, rtol=0.1)
    at_maximum = gaussian(sample)([np.array([0.4, np.log(2.0)])])[0].sum()
    assert found.log_likelihood == pytest.approx(at_maximum, abs=1e-3)


def test_it_rests_within_its_tolerance_of_the_maximum(rng):
    sample = normalised(rng, mean=0.4, sigma=2.0)
    at_maximum = gaussian(sample)([np.array([0.4, np.log(2.0)])])[0].sum()
    found = search(gaussian(sample), [0.0, 0.0])
    assert at_maximum - 0.5 < found.log_likelihood <= at_maximum


@pytest.mark.parametrize("start", [[8.0, -1.0], [-8.0, 3.0], [0.0, 6.0]])
def test_a_start_far_off_is_brought_back(rng, start):
    sample = normalised(rng, mean=0.4, sigma=2.0)
    found = search(gaussian(sample), start, largest=np.array([10.0, 1.5]))
    assert np.allclose(found.point, [0.4, np.log(2.0)], atol=0.05)
    assert found.rounds <= 12


def test_parameters_of_very_different_scale(rng):
    sample = normalised(rng, mean=0.4, sigma=2.0)

    def scaled(points):
        return gaussian(sample)([np.array([1e4 * mean, level]) for mean, level in points])

    found = search(scaled, [-2e-4, 1.5], steps=np.array([1e-6, 0.03]), largest=np.array([1e-3, 0.7]))
    assert found.point[0] == pytest.approx(0.4e-4, abs=0.05e-4)
    assert found.point[1] == pytest.approx(np.log(2.0), abs=0.02)
    assert found.sigma[0] == pytest.approx(1e-4 * 2.0 / np.sqrt(SAMPLES), rel=0.1)


def test_no_round_moves_farther_than_it_may(rng):
    sample = normalised(rng, mean=5.0, sigma=1.0)
    visited = []

    def watched(points):
        visited.extend(points)
        return gaussian(sample)(points)

    search(watched, [0.0, 0.0], largest=np.array([0.25, 0.7]))
    farthest = np.array(visited)[:, 0].max()
    # Twelve rounds of a quarter, and the finite difference about the last but one.
    assert farthest == pytest.approx(3.0)


@pytest.mark.parametrize("start", [0.5, 5.0])
def test_a_level_that_is_not_needed_ends_at_its_lowest_value(rng, start):
    sample = normalised(rng, mean=0.0, sigma=0.95)
    found = search(added_level(sample), [np.log(start)], lowest=np.array([LOWEST]))
    assert found.point[0] == LOWEST
    assert np.isinf(found.sigma[0])


def test_a_level_that_is_needed_is_found_though_it_could_be_left_out(rng):
    sample = normalised(rng, mean=0.0, sigma=np.hypot(1.0, 0.5))
    found = search(added_level(sample), [np.log(2.0)], lowest=np.array([LOWEST]))
    assert np.isfinite(found.sigma[0])
    assert abs(found.point[0] - np.log(0.5)) < found.sigma[0]
    assert 0.0 < found.sigma[0] < 0.2


def test_what_is_not_needed_takes_no_certainty_from_the_rest(rng):
    sample = normalised(rng, mean=0.4, sigma=0.95)

    def both(points):
        return [normal_density(sample, mean, np.sqrt(1.0 + np.exp(2.0 * level))) for mean, level in points]

    found = search(both, [0.0, 0.0], lowest=np.array([-np.inf, LOWEST]))
    assert found.point[1] == LOWEST
    assert np.isinf(found.sigma[1])
    assert found.point[0] == pytest.approx(0.4, abs=0.02)
    # The model says 1, the sample 0.95.
    assert found.sigma[0] == pytest.approx(0.95 / np.sqrt(SAMPLES), rel=0.05)


def test_a_misspecified_model_gets_the_standard_deviation_of_the_sandwich(rng):
    """One in ten samples has five times the noise that the rest has; the model knows one level."""
    spread = np.where(np.arange(SAMPLES) % 10 == 0, 5.0, 1.0)
    sample = spread * rng.standard_normal(SAMPLES)
    sample -= sample.mean()
    found = search(gaussian(sample), [0.1, 0.1], tolerance=1e-3)
    level = sample.std()
    assert found.point[1] == pytest.approx(np.log(level), abs=0.01)
    naive = np.array([level / np.sqrt(SAMPLES), 1.0 / np.sqrt(2.0 * SAMPLES)])
    kurtosis = np.mean(sample**4) / level**4
    sandwich = naive * np.array([1.0, np.sqrt((kurtosis - 1.0) / 2.0)])
    assert np.allclose(found.sigma, sandwich, rtol=0.1)
    assert found.sigma[1] > 2.0 * naive[1]


def test_points_that_cannot_be_evaluated_are_kept_away_from(rng):
    sample = normalised(rng, mean=0.4, sigma=2.0)

    def failing(points):
        values = gaussian(sample)(points)
        return [
            value if level < 1.0 else np.full(SAMPLES, -np.inf)
            for value, (_, level) in zip(values, points, strict=True)
        ]

    found = search(failing, [0.0, 0.9])
    assert np.allclose(found.point, [0.4, np.log(2.0)], atol=0.05)
    assert np.isfinite(found.log_likelihood)


def test_damped_steps_are_looked_at_only_where_newtons_gains_too_little(rng):
    sample = normalised(rng, mean=0.4, sigma=2.0)
    sizes = []

    def counted(points):
        sizes.append(len(points))
        return gaussian(sample)(points)

    search(counted, [0.38, np.log(1.9)], tolerance=1e-3)
    assert set(sizes) == {5, 1}
    sizes.clear()
    search(counted, [0.4, np.log(200.0)], largest=np.full(2, 50.0), tolerance=1e-3)
    assert 2 in sizes


def test_a_frame_that_is_far_off_does_not_correlate_what_is_not(rng):
    scores = rng.standard_normal((400, 2))
    scores[7] = 300.0, 200.0
    assert np.corrcoef(scores.T)[0, 1] > 0.9
    kept = without_tails(scores)
    assert abs(np.corrcoef(kept.T)[0, 1]) < 0.2
    assert np.allclose(kept[0] - kept[1], scores[0] - scores[1])
