"""Frames without observations and biases that walk: what changes, and what does not."""

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import from_first
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.comparison.open import open_dataset
from vislam.core import estimator
from vislam.core.step import TWIST_BIAS
from vislam.estimators import loop
from vislam.evaluation.normalised import bias_errors
from vislam.repair.tracks import duplicated_observations
from vislam.simulation import SimulationConfig, simulate

DRIVE = SimulationConfig(frames=400, tracks_in_view=20, gyro_bias=(0.004, -0.003, 0.005))
WALKING = replace(DRIVE, gyro_bias_walk=2e-3, velocity_bias_walk=0.1)


def simulated(config, seed=5):
    return simulate(config, seed=seed, name="s")


def test_a_constant_bias_has_one_row_and_a_walking_one_a_row_a_frame():
    assert simulated(DRIVE)[1].bias == pytest.approx([0.004, -0.003, 0.005, 0.0, 0.0, 0.0])
    bias = simulated(WALKING)[1].bias
    assert bias.shape == (400, 6)
    assert bias[0] == pytest.approx([0.004, -0.003, 0.005, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("noise", ["sample", "step"])
def test_a_walk_changes_the_twist_by_the_walk_and_nothing_else(noise):
    still, _ = simulated(replace(DRIVE, inertial_noise=noise))
    walking, truth = simulated(replace(WALKING, inertial_noise=noise))
    assert np.array_equal(still.pixels, walking.pixels)
    gone = truth.bias - truth.bias[0]
    if noise == "step":
        # The bias at a frame is that of the step that follows, which two samples stand for.
        gone = np.repeat(gone[:-1], 2, axis=0)
    assert walking.twist - still.twist == pytest.approx(gone, abs=1e-12)


@pytest.mark.statistical
def test_the_walk_has_independent_steps_of_the_stated_size():
    config = replace(WALKING, frames=4001, tracks_in_view=1, path="loop")
    steps = np.diff(simulated(config)[1].bias, axis=0) / np.sqrt(config.period)
    white = steps / np.repeat([2e-3, 0.1], 3)
    # Five standard deviations of an estimated variance, sqrt(2 / n).
    within = 5.0 * np.sqrt(2.0 / 4000)
    assert np.abs(white.T @ white / 4000 - np.eye(6)).max() < within
    assert np.abs(white[1:].T @ white[:-1] / 4000).max() < within


@pytest.mark.statistical
def test_a_frame_is_dropped_as_often_as_stated_and_never_the_first():
    sequence, truth = simulated(replace(DRIVE, dropped_probability=0.3, frames=2000, tracks_in_view=3))
    empty = np.diff(sequence.offset) == 0
    assert not empty[0]
    # Five standard deviations of a share of 2000, and the few frames that no track is left in anyway.
    assert empty.mean() == pytest.approx(0.3, abs=5.0 * np.sqrt(0.3 * 0.7 / 2000))
    assert len(truth.points_world) == len(sequence.track) == sequence.offset[-1]
    assert len(sequence.stamp) == len(sequence.twist) == 2000


def test_tracks_go_on_behind_a_dropped_frame():
    sequence, truth = simulated(replace(DRIVE, dropped_probability=0.2))
    assert not np.any(np.diff(sequence.offset)[np.diff(sequence.offset) > 0] < 5)
    empty = np.flatnonzero(np.diff(sequence.offset) == 0)
    alone = [k for k in empty if k - 1 not in empty and k + 1 not in empty and k + 1 < len(sequence)]
    shared = [np.intersect1d(*(ids(sequence, frame) for frame in (k - 1, k + 1))) for k in alone]
    assert np.mean([len(both) for both in shared]) > 10
    # A track is one point, before and after.
    _, first, back = np.unique(sequence.track, return_index=True, return_inverse=True)
    assert np.array_equal(truth.points_world, truth.points_world[first][back])


def test_no_frame_is_duplicated_where_the_one_before_was_not_written():
    sequence, _ = simulated(replace(DRIVE, dropped_probability=0.3, duplication_probability=0.5))
    duplicated, _ = duplicated_observations(sequence)
    empty = np.diff(sequence.offset) == 0
    assert duplicated.sum() > 50
    assert not np.any(duplicated & empty)
    assert not np.any(duplicated[1:] & empty[:-1])


@pytest.mark.parametrize("name", ["ekf", "isam2"])
def test_estimators_get_through_a_drive_with_both(name):
    run, reference = estimated(name)
    assert run.complete, run.log.error
    error = run.final.world_T_imu[:, :3, 3] - from_first(reference.pose)[:, :3, 3]
    assert np.abs(error).max() < 1.0


def test_a_run_is_scored_against_the_bias_of_each_frame():
    run, reference = estimated("ekf")
    found = bias_errors(run, reference.bias)
    assert found.error == pytest.approx(reference.bias - run.states[TWIST_BIAS].value)


def estimated(name):
    walking = replace(WALKING, gyro_bias_walk=2e-4, velocity_bias_walk=2e-3)
    drive = replace(walking, frames=60, dropped_probability=0.2)
    config = Config(name="both", data=DataConfig(simulation=drive), noise=NoiseConfig(pixel_sigma_px=0.5))
    dataset = open_dataset(config.data, seed=2)
    built = estimator.find(name)(make_problem(config, dataset), {})
    run = loop.run(built, dataset.sequence, pixel_sigma(config, dataset), name=name)
    return run, dataset.reference


def ids(sequence, frame):
    return sequence.track[sequence.offset[frame] : sequence.offset[frame + 1]]
