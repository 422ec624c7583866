"""NEES, its interval and coverage, on errors that are drawn from known covariances."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.evaluation.test_evaluation import circle, made_run
from vislam.evaluation.consistency import (
    PARTS,
    average,
    average_interval,
    consistency,
    coverage,
    nees,
)
from vislam.geometry import se3

seeds = st.integers(0, 2**32 - 1)
CERTAIN = 1.0 - 1e-9


def drawn(seed, runs=60, frames=20):
    """Errors ``(runs, frames, 6)`` drawn from covariances ``(frames, 6, 6)``."""
    generator = np.random.default_rng(seed)
    factor = np.diag([0.01] * 3 + [0.5] * 3) @ (np.eye(6) + 0.3 * generator.normal(size=(frames, 6, 6)))
    error = np.einsum("tij,rtj->rti", factor, generator.normal(size=(runs, frames, 6)))
    return error, factor @ factor.transpose(0, 2, 1)


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_draws_lie_inside_the_interval_and_half_the_covariance_does_not(seed):
    error, cov = drawn(seed)
    true = average(nees(error, np.broadcast_to(cov, (*error.shape, 6))), freedom=6, probability=CERTAIN)
    assert true.share_inside == 1.0
    assert true.overall_low < 1.0 < true.overall_high
    halved = average(nees(error, np.broadcast_to(0.5 * cov, (*error.shape, 6))), freedom=6)
    assert np.allclose(halved.value, 2.0 * true.value)
    assert halved.share_inside == 0.0
    assert halved.overall_low > 1.0


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_the_units_of_the_error_do_not_matter(seed):
    error, cov = drawn(seed, runs=1)
    generator = np.random.default_rng(seed + 1)
    turn, _ = np.linalg.qr(generator.normal(size=(6, 6)))
    change = turn * generator.uniform(0.5, 2.0, 6)
    moved = nees(error[0] @ change.T, change @ cov @ change.T)
    # The covariances are anything but round.
    assert np.allclose(moved, nees(error[0], cov), rtol=1e-3)


@pytest.mark.parametrize(("freedom", "runs", "probability"), [(6, 50, 0.95), (3, 12, 0.95), (6, 5, 0.8)])
def test_the_interval_is_that_of_a_simulation(rng, freedom, runs, probability):
    averages = np.sum(rng.normal(size=(20000, runs * freedom)) ** 2, axis=1) / (runs * freedom)
    tail = 0.5 * (1.0 - probability)
    found = np.quantile(averages, [tail, 1.0 - tail])
    assert np.allclose(
        found, average_interval(freedom=freedom, runs=runs, probability=probability), atol=0.01
    )


def test_the_mean_of_dependent_times_is_as_uncertain_as_its_runs_are(rng):
    """Errors that stay all through a run: its many times tell no more than one."""
    inside = []
    for _ in range(200):
        values = np.repeat(np.sum(rng.normal(size=(30, 1, 6)) ** 2, axis=2), 100, axis=1)
        found = average(values, freedom=6)
        inside.append(found.overall_low < 1.0 < found.overall_high)
    assert 0.88 < np.mean(inside) < 0.99


def test_the_error_of_a_run_is_on_the_right_of_its_poses(rng):
    estimate = circle(frames=40)
    cov = np.broadcast_to(np.diag([1e-4, 2e-4, 3e-4, 0.01, 0.02, 0.03]), (40, 6, 6))
    error = np.sqrt(np.diagonal(cov, axis1=1, axis2=2)) * rng.normal(size=(40, 6))
    run = made_run(
        "one", estimate, world_T_imu_causal=estimate[::-1], pose_cov=cov, pose_cov_causal=4.0 * cov
    )
    final = consistency(run, se3.retract(estimate, error))
    assert np.allclose(final.error, error, atol=1e-9)
    for name, part in PARTS.items():
        assert np.allclose(final.nees[name], nees(error[:, part], cov[:, part, part]))
    causal = consistency(run, se3.retract(estimate[::-1], error), causal=True)
    assert np.allclose(causal.nees["pose"], 0.25 * final.nees["pose"])
    assert np.allclose(causal.sigma, 2.0 * final.sigma)


def test_coverage_is_a_share_by_component(rng):
    error = rng.normal(size=(50, 400, 2)) * [1.0, 2.0]
    found = coverage(error, np.ones_like(error))
    assert np.allclose(found, [0.9973, 0.8664], atol=0.01)
