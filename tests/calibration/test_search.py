"""The search of the maximum, on likelihoods whose maximum and standard deviations have a closed form."""

import numpy as np
import pytest

from vislam.calibration.search import ROUNDS, Bounds, Local, Secants, maximise, with_curvature

SAMPLES = 2000
LOWEST = np.log(1e-3)


def normalised(rng, *, mean, sigma, count=SAMPLES):
    """Normal samples of exactly that mean and standard deviation."""
    sample = rng.standard_normal(count)
    return mean + sigma * (sample - sample.mean()) / sample.std()


def normal_density(sample, mean, sigma):
    """Log densities, one a sample, but for a constant; none without a standard deviation."""
    if sigma == 0.0:
        return np.full(len(sample), -np.inf)
    return -0.5 * ((sample - mean) / sigma) ** 2 - np.log(sigma)


class Normal:
    """Likelihood of a sample whose mean and standard deviation are functions of a point."""

    def __init__(self, sample, moments):
        self.sample, self.moments = sample, moments

    def __call__(self, points):
        return [normal_density(self.sample, *self.moments(point)) for point in points]

    def local(self, point, *, times):
        """Score by central differences, and the expected information times a factor."""
        h, count = 1e-5, len(point)
        beside = [point + sign * h * row for row in np.eye(count) for sign in (1.0, -1.0)]
        here, *values = self([point, *beside])
        if not np.isfinite(here).all():
            return Local(point, -np.inf, np.zeros((SAMPLES, count)), np.eye(count))
        scores = np.column_stack(
            [(up - down) / (2.0 * h) for up, down in zip(values[::2], values[1::2], strict=True)]
        )
        moments = np.array([self.moments(one) for one in beside])
        mean, sigma = ((moments[::2] - moments[1::2]) / (2.0 * h) / self.moments(point)[1]).T
        information = np.outer(mean, mean) + 2.0 * np.outer(sigma, sigma) + 1e-9 * np.eye(count)
        return Local(point, float(here.sum()), scores, times * SAMPLES * information)


def gaussian(sample):
    """Points (mean, logarithm of sigma)."""
    return Normal(sample, lambda point: (point[0], np.exp(point[1])))


def added_level(sample):
    """Points (logarithm of q): the sample has variance 1 + q^2."""
    return Normal(sample, lambda point: (0.0, np.sqrt(1.0 + np.exp(2.0 * point[0]))))


def search(evaluate, start, *, lowest=None, largest=None, times=1.0, **options):
    count = len(start)
    bounds = Bounds(
        np.full(count, -np.inf) if lowest is None else lowest,
        np.full(count, 0.7) if largest is None else largest,
    )
    return maximise(
        lambda point: evaluate.local(point, times=times),
        lambda points: [float(one.sum()) for one in evaluate(points)],
        np.array(start, float),
        bounds=bounds,
        **options,
    )


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

    scaled = Normal(sample, lambda point: (1e4 * point[0], np.exp(point[1])))
    found = search(scaled, [-2e-4, 1.5], largest=np.array([1e-3, 0.7]))
    assert found.point[0] == pytest.approx(0.4e-4, abs=0.05e-4)
    assert found.point[1] == pytest.approx(np.log(2.0), abs=0.02)
    assert found.sigma[0] == pytest.approx(1e-4 * 2.0 / np.sqrt(SAMPLES), rel=0.1)


def test_no_round_moves_farther_than_it_may(rng):
    sample = normalised(rng, mean=5.0, sigma=1.0)
    visited = []

    def watched(point):
        visited.append(point)
        return point[0], np.exp(point[1])

    search(Normal(sample, watched), [0.0, 0.0], largest=np.array([0.25, 0.7]))
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

    both = Normal(sample, lambda point: (point[0], np.sqrt(1.0 + np.exp(2.0 * point[1]))))
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

    failing = Normal(sample, lambda point: (point[0], np.exp(point[1]) if point[1] < 1.0 else 0.0))
    found = search(failing, [0.0, 0.9])
    assert np.allclose(found.point, [0.4, np.log(2.0)], atol=0.05)
    assert np.isfinite(found.log_likelihood)


@pytest.mark.parametrize("times", [0.3, 1.0, 8.0])
def test_information_that_is_off_is_corrected_by_the_steps_taken(rng, times):
    sample = normalised(rng, mean=0.4, sigma=2.0)
    found = search(gaussian(sample), [0.2, np.log(1.5)], times=times, tolerance=1e-3)
    error = np.array([2.0 / np.sqrt(SAMPLES), 1.0 / np.sqrt(2.0 * SAMPLES)])
    assert np.all(np.abs(found.point - [0.4, np.log(2.0)]) < 0.05 * error)
    # Steps of an eighth of what is left would take some forty.
    assert found.rounds < ROUNDS


def test_secants_have_the_moves_found_what_they_did():
    before = Local(np.zeros(2), 0.0, np.array([[6.0, 2.0]]), np.eye(2))
    after = Local(np.array([1.0, 0.5]), 1.0, np.array([[2.0, 1.0]]), 3.0 * np.eye(2))
    secants = Secants()
    secants.add(before, after)
    assert np.allclose(secants.information(after) @ [1.0, 0.5], [4.0, 1.0])
    for _ in range(5):
        secants.add(before, after)
    assert len(secants.pairs) == 2


def test_a_move_that_gains_nothing_is_shortened(rng):
    sample = normalised(rng, mean=0.4, sigma=2.0)
    found = search(gaussian(sample), [0.4, np.log(6.0)], times=0.1, largest=np.full(2, 50.0))
    assert np.allclose(found.point, [0.4, np.log(2.0)], atol=0.05)


def test_rounds_end_where_no_more_are_allowed(rng):
    sample, rounds = normalised(rng, mean=5.0, sigma=1.0), []
    found = search(gaussian(sample), [0.0, 0.0], most=2, on_round=rounds.append)
    assert [one.number for one in rounds] == [1, 2]
    assert found.rounds == 2
    assert np.array_equal(found.point, rounds[-1].point)
    assert found.log_likelihood == pytest.approx(gaussian(sample)([found.point])[0].sum())


def test_a_step_is_the_best_within_the_largest_moves():
    sigma, largest = np.array([0.1, 0.2, 0.003]), np.array([0.7, 9.0, 0.02])
    correlated = np.array([[1.0, 0.8, 0.0], [0.8, 1.0, 0.0], [0.0, 0.0, 1.0]])
    information = correlated / sigma[:, None] / sigma
    away = np.array([3.0, 0.1, 0.003])
    here = Local(away, 0.0, -(information @ away)[None], information)
    move, _ = Bounds(np.full(3, -np.inf), largest).step(here, information, np.ones(3, bool))
    assert move[0] == pytest.approx(-largest[0])
    # The others are where the quadratic is highest, that one given.
    slope = here.gradient - information @ move
    assert np.allclose(slope[1:] * sigma[1:], 0.0, atol=1e-6)


@pytest.mark.parametrize("times", [0.5, 1.0, 4.0])
def test_intervals_are_by_the_curvature_whatever_the_information_says(rng, times):
    sample = normalised(rng, mean=0.4, sigma=2.0)
    rough = search(gaussian(sample), [0.4, np.log(2.0)], times=times)
    spans = np.array([0.02, 0.01])
    found = with_curvature(
        rough, lambda points: [float(one.sum()) for one in gaussian(sample)(points)], spans
    )
    error = np.array([2.0 / np.sqrt(SAMPLES), 1.0 / np.sqrt(2.0 * SAMPLES)])
    assert np.allclose(found.sigma, error, rtol=0.1)
    assert np.allclose(np.diagonal(found.information), error**-2, rtol=0.03)
    if times != 1.0:
        assert not np.allclose(rough.sigma, error, rtol=0.3)


def test_along_what_bends_upwards_the_expected_information_is_kept(rng):
    sample = normalised(rng, mean=0.4, sigma=2.0)
    rough = search(gaussian(sample), [0.4, np.log(2.0)])
    found = with_curvature(rough, lambda points: [np.inf] * len(points), np.full(2, 0.01))
    assert np.array_equal(found.sigma, rough.sigma)
