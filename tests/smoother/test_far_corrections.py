"""Steps that correct much of a drive: few landmarks near the camera, long gaps, landmarks seen again."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.conftest import recorded
from tests.smoother.drives import drive
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import LandmarksConfig, load
from vislam.comparison.open import open_dataset
from vislam.core.estimator import find
from vislam.estimators.loop import run
from vislam.estimators.smoother import solver
from vislam.geometry import se3
from vislam.simulation.settings import RigConfig

HAND_HELD = RigConfig(
    fx=400.0,
    fy=400.0,
    cx=320.0,
    cy=240.0,
    width=640.0,
    height=480.0,
    baseline=0.24,
    position_imu=(0.0, 0.0, 0.0),
    pitch_deg=10.0,
)
NEAREST = 1.5
CONFIGS = Path(__file__).parents[2] / "configs"
FULLY = {"window": 1000, "relinearize_every": 1, "wildfire_threshold": 0.0}


@pytest.fixture(scope="module")
def gaps():
    """Twice round, five tracks in view, from 1.5 m on; nothing at all in 15 of 40 frames."""
    config, dataset = drive(
        seed=0,
        frames=100,
        path="circuit",
        speed=2.0,
        hills_m=0.0,
        landmarks="recognised",
        field_per_metre=2.0,
        tracks_in_view=5.0,
        depth_min=NEAREST,
        depth_max=8.0,
        loss_probability=0.1,
        rig=HAND_HELD,
        gyro=0.3,
        velocity=0.3,
        inertial_noise="step",
    )
    config = replace(config, data=replace(config.data, landmarks=LandmarksConfig(kept="always")))
    sequence = dataset.sequence
    return config, replace(dataset, sequence=sequence.select(sequence.frame_of % 40 < 25))


def of_isam2(gaps, **options):
    config, dataset = gaps
    found = run(
        find("isam2")(make_problem(config, dataset), options),
        dataset.sequence,
        pixel_sigma(config, dataset),
        name="isam2",
    )
    assert found.complete, found.log.error
    return found


def apart(one, other):
    """Mean distance of two filtered paths [m]."""
    between = se3.local(one.filtered.world_T_imu, other.filtered.world_T_imu)
    return float(np.linalg.norm(between[:, 3:], axis=1).mean())


def test_a_far_correction_leaves_nothing_as_it_was_linearised_before(gaps, monkeypatch):
    exact, found = of_isam2(gaps, **FULLY), of_isam2(gaps)
    assert 10 < found.log.counts["steps_relinearised_whole"] < 60
    monkeypatch.setattr(solver, "_TURNED", np.inf)
    monkeypatch.setattr(solver, "_MOVED", np.inf)
    resting = of_isam2(gaps)
    assert resting.log.counts["steps_relinearised_whole"] == 0
    assert apart(found, exact) < 0.25 * apart(resting, exact)
    assert apart(found, exact) < 0.005 * NEAREST


def test_who_linearises_once_does_not_do_it_again(gaps):
    found = of_isam2(gaps, relinearize_every=0, relinearize_beyond=None, final="as_is")
    assert found.log.counts["steps_relinearised_whole"] == 0
    assert found.log.counts["steps_relinearised_recent"] == 0


@pytest.mark.slow
@pytest.mark.parametrize("kept", ["most 100", "while_tracked"])
def test_starry_night_without_a_tenth_of_its_tracks(kept):
    """Poses at rest were up to 1 rad from where they were linearised there, and the steps diverged."""
    folder = recorded("clement2015/dataset3.mat").parents[1]
    config = load(CONFIGS / "battle" / "starry_night.yaml", overrides={"data.landmarks.kept": kept})
    held_out = replace(config.held_out, share=0.1)
    dataset = open_dataset(config.data, seed=0, data_dir=folder, held_out=held_out)
    dataset = replace(dataset, sequence=dataset.sequence.first(450), held_out=None)
    problem, sigma = make_problem(config, dataset), pixel_sigma(config, dataset)
    gating = run(find("ekf_invariant")(problem, {}), dataset.sequence, sigma, name="ekf_invariant")
    found = run(find("isam2")(problem, {}), dataset.sequence, sigma, name="isam2", usable=gating.used)
    assert found.log.counts["cholesky_failures"] == found.log.counts["landmarks_rejected"] == 0
    squares, freedom = found.fit
    assert squares < 1.5 * freedom


def test_a_lag_that_holds_everything_is_relinearised_as_the_whole_graph_is(gaps, monkeypatch):
    config, dataset = gaps
    dataset = replace(dataset, sequence=dataset.sequence.first(45))
    monkeypatch.setattr(solver, "_TURNED", 1e-7)
    monkeypatch.setattr(solver, "_MOVED", 1e-7)
    problem, sigma = make_problem(config, dataset), pixel_sigma(config, dataset)
    whole, lag = (
        run(find(name)(problem, options), dataset.sequence, sigma, name=name)
        for name, options in (("isam2", FULLY), ("fixed_lag", {"lag_s": 1000.0}))
    )
    assert lag.log.counts["steps_relinearised_whole"] > 20
    assert apart(whole, lag) < 1e-5
    assert np.array_equal(whole.used, lag.used)


@pytest.mark.slow
def test_a_lag_is_not_carried_off_by_landmarks_that_outlive_it():
    """Kept where they were first linearised, those a metre away were behind the camera after 230 frames."""
    folder = recorded("clement2015/dataset3.mat").parents[1]
    config = load(CONFIGS / "battle" / "starry_night.yaml")
    dataset = open_dataset(config.data, seed=0, data_dir=folder, held_out=replace(config.held_out, share=0.1))
    dataset = replace(dataset, sequence=dataset.sequence.first(450), held_out=None)
    problem, sigma = make_problem(config, dataset), pixel_sigma(config, dataset)
    gating = run(find("ekf_invariant")(problem, {}), dataset.sequence, sigma, name="ekf_invariant")
    held, found = (
        run(
            find("fixed_lag")(problem, options), dataset.sequence, sigma, name="fixed_lag", usable=gating.used
        )
        for options in ({"relinearize_beyond": None}, {})
    )
    assert held.log.counts["landmarks_rejected"] > 5
    assert found.log.counts["landmarks_rejected"] == found.log.counts["cholesky_failures"] == 0
    step = np.linalg.norm(np.diff(found.filtered.world_T_imu[:, :3, 3], axis=0), axis=1)
    assert step.max() < 0.5
