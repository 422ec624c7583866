"""What the filters believe to learn of where the world is: the consistent ones nothing."""

import numpy as np
import pytest

from vislam.comparison import make_problem, pixel_sigma
from vislam.ekf import EkfEstimator, EkfOptions, observability
from vislam.ekf.linear import Update
from vislam.ekf.measurement import Camera
from vislam.ekf.observability import Unobservable
from vislam.ekf.state import JointState

NOTHING = 1e-9
"""Of what the standard filter gains."""


def gained(dataset, config, **options):
    """Information ``(6,)`` gained over all frames."""
    estimator = EkfEstimator(
        make_problem(config, dataset), EkfOptions(gate=False, finished="as_left", **options)
    )
    estimator.state.steps = []
    followed, total = Unobservable(), np.zeros(6)
    for frame in dataset.sequence.frames(pixel_sigma(config, dataset)):
        estimator.process(frame, np.zeros(len(frame.track), bool))
        total += followed.follow(estimator.state.steps)
        estimator.state.steps.clear()
    assert followed.directions.shape == (len(estimator.state.cov), 6)
    return total


@pytest.mark.parametrize("landmarks", ["point", "disparity"])
def test_only_the_standard_filter_gains_what_cannot_be_known(short, short_config, landmarks):
    standard = gained(short, short_config, landmarks=landmarks)
    assert np.all(standard > 1.0)
    for error in ("first_estimates", "invariant"):
        found = gained(short, short_config, landmarks=landmarks, error=error)
        assert np.all(found < NOTHING * standard)


@pytest.mark.parametrize("error", ["first_estimates", "invariant"])
def test_a_wrong_sign_is_seen(short, short_config, error, monkeypatch):
    standard, true = gained(short, short_config), Camera.jacobians

    def turned(self, *arguments):
        by_nav, by_landmark = true(self, *arguments)
        by_nav[:, :, :3] *= -1.0
        return by_nav, by_landmark

    monkeypatch.setattr(Camera, "jacobians", turned)
    assert np.all(gained(short, short_config, error=error)[:3] > standard[:3])


def test_coordinates_that_are_not_reset_are_seen(short, short_config, monkeypatch):
    """Guards the first test: the invariant filter owes its zero to the reset."""
    standard, true = gained(short, short_config), JointState._retract

    def without_reset(self, error):
        true(self, error)

    monkeypatch.setattr(JointState, "_retract", without_reset)
    found = gained(short, short_config, error="invariant")
    assert np.all(found[:3] > 1e-3 * standard[:3])


def test_the_noise_of_an_update_is_found_in_it(short, short_config):
    problem = make_problem(short_config, short)
    estimator = EkfEstimator(problem, EkfOptions(gate=False))
    updates = 0
    for frame in short.sequence.frames(pixel_sigma(short_config, short)):
        estimator.process(frame, np.zeros(len(frame.track), bool))
    for step in estimator.state.steps:
        if isinstance(step, Update):
            white = observability._white(step).reshape(-1, 3)
            assert np.allclose(white, problem.track_noise.sigma**2, rtol=1e-6)
            updates += 1
    assert updates > 5
