"""What the filters believe to learn of where the world is: the consistent ones nothing."""

from dataclasses import replace

import numpy as np
import pytest

from tests.shared_errors import every_shared_error
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.estimators import loop
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.ekf.linear import Update
from vislam.estimators.ekf.measurement import View
from vislam.estimators.ekf.state import JointState

NOTHING = 1e-9
"""Of what the standard filter gains."""


def gained(dataset, config, **options):
    """Information ``(6,)`` gained over all frames."""
    options = {"gate": False, "marginalised_landmarks": "filtered", "observability": True, **options}
    solver = EkfEstimator(make_problem(config, dataset), EkfOptions(**options))
    run = loop.run(solver, dataset.sequence, pixel_sigma(config, dataset), name="ekf")
    assert run.complete
    return run.innovations.spurious_information.sum(axis=0)


@pytest.mark.parametrize("landmarks", ["point", "anchored_uvd"])
def test_only_the_standard_filter_gains_what_cannot_be_known(short, short_config, landmarks):
    standard = gained(short, short_config, landmarks=landmarks)
    assert np.all(standard > 1.0)
    for error in ("fej", "invariant"):
        found = gained(short, short_config, landmarks=landmarks, error=error)
        assert np.all(found < NOTHING * standard)


@pytest.mark.parametrize("landmarks", ["point", "anchored_uvd"])
@pytest.mark.parametrize("walk", [0.0, 1e-3])
def test_errors_that_all_tracks_share_change_nothing_of_it(short, short_config, landmarks, walk):
    """With all of them estimated: a motion of the world leaves them as they are."""
    config = replace(short_config, noise=replace(short_config.noise, **every_shared_error(walk)))
    standard = gained(short, config, landmarks=landmarks)
    assert np.all(standard > 1.0)
    for error in ("fej", "invariant"):
        assert np.all(gained(short, config, landmarks=landmarks, error=error) < NOTHING * standard)


@pytest.mark.parametrize("error", ["fej", "invariant"])
def test_a_wrong_sign_is_seen(short, short_config, error, monkeypatch):
    standard, true = gained(short, short_config), View.jacobians

    def turned(self, *arguments):
        by_nav, by_landmark = true(self, *arguments)
        by_nav[:, :, :3] *= -1.0
        return by_nav, by_landmark

    monkeypatch.setattr(View, "jacobians", turned)
    assert np.all(gained(short, short_config, error=error)[:3] > standard[:3])


def test_coordinates_that_are_not_reset_are_seen(short, short_config, monkeypatch):
    """Guards the first test: the invariant filter owes its zero to the reset."""
    standard = gained(short, short_config)
    true = JointState._retract

    def no_reset(self, error):
        true(self, error)

    monkeypatch.setattr(JointState, "_retract", no_reset)
    assert np.all(gained(short, short_config, error="invariant") > 1e-3 * standard)


def test_the_way_back_takes_nothing_from_the_meter(short, short_config):
    """Steps are kept for it as well."""
    alone = gained(short, short_config)
    assert np.array_equal(gained(short, short_config, marginalised_landmarks="smoothed"), alone)
    assert np.array_equal(
        gained(short, short_config, marginalised_landmarks="smoothed", memory_mb=0.1), alone
    )


def test_the_noise_of_an_update_is_found_in_it(short, short_config):
    problem = make_problem(short_config, short)
    solver = EkfEstimator(problem, EkfOptions(gate=False, track_errors="states"))
    updates = 0
    for frame in short.sequence.frames(pixel_sigma(short_config, short)):
        solver.process(frame)
    for step in solver.state.steps:
        if isinstance(step, Update):
            white = step.white.reshape(-1, 3)
            assert np.allclose(white, problem.track_noise.sigma**2, rtol=1e-6)
            updates += 1
    assert updates > 5
