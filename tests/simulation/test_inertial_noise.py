"""The noise of simulated inertial data: one sample a frame, or the mean twist of each step."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.geometry import se3
from vislam.repair.inertial import Clock
from vislam.simulation import SimulationConfig, simulate

STEPS = 4000
QUIET = SimulationConfig(
    frames=STEPS + 1,
    tracks_in_view=1,
    path="loop",
    gyro_bias=(0.01, -0.02, 0.03),
    velocity_bias=(0.1, 0.2, -0.3),
    inertial_noise="step",
    gyro_sigma=0.0,
    velocity_sigma=0.0,
)
NOISY = replace(QUIET, gyro_sigma=0.02, velocity_sigma=0.3)
SIGMA = np.repeat([0.02, 0.3], 3)


def step_error(config):
    """Mean twist of each step less the true one and the bias."""
    sequence, truth = simulate(config, seed=5, name="s")
    true = se3.local(truth.world_T_imu[:-1], truth.world_T_imu[1:]) / np.diff(sequence.stamp)[:, None]
    return sequence.step_means()[0][1:] - true - truth.bias


def test_steps_without_noise_have_the_true_mean_twist_and_the_bias():
    # What lies between two steps is a 1e-6 part of them, over which the twist changes as from step to step.
    assert np.abs(step_error(replace(QUIET, frames=200))).max() < 1e-6


@pytest.mark.statistical
def test_noise_of_steps_has_the_stated_covariance_and_none_with_the_next_step():
    error = step_error(NOISY) / SIGMA
    # Five standard deviations of an estimated correlation, sqrt(1 / n), or variance, sqrt(2 / n).
    within = 5.0 * np.sqrt(2.0 / STEPS)
    assert np.abs(error.mean(axis=0)).max() < within
    assert np.abs(error.T @ error / STEPS - np.eye(6)).max() < within
    assert np.abs(error[1:].T @ error[:-1] / STEPS).max() < within


@pytest.mark.statistical
def test_samples_share_their_noise_with_the_next_step():
    quiet, noisy = (step_error(replace(config, inertial_noise="sample")) for config in (QUIET, NOISY))
    error = (noisy - quiet) / SIGMA
    # Mean of two samples: variance 1 / 2, and 1 / 4 in common.
    within = 5.0 * np.sqrt(2.0 / STEPS)
    assert np.abs(error.T @ error / STEPS - 0.5 * np.eye(6)).max() < within
    assert np.abs(error[1:].T @ error[:-1] / STEPS - 0.25 * np.eye(6)).max() < within


def test_steps_are_late_with_the_clock_and_right_again_once_it_is_repaired():
    late, _ = simulate(replace(QUIET, frames=50, clock_offset=0.05), seed=5, name="s")
    on_time, _ = simulate(replace(QUIET, frames=50), seed=5, name="s")
    assert np.abs(late.step_means()[0] - on_time.step_means()[0]).max() > 1e-3
    repaired = Clock(offset=0.05).apply(late)
    assert repaired.step_means()[0] == pytest.approx(on_time.step_means()[0], abs=1e-9)


def test_the_third_velocity_of_steps_can_be_the_vertical():
    config = replace(QUIET, frames=50, navigation_frame_velocity=True)
    sequence, truth = simulate(config, seed=5, name="s")
    climbed = np.diff(truth.world_T_imu[:, 2, 3]) / np.diff(sequence.stamp)
    assert sequence.step_means()[0][1:, 5] == pytest.approx(climbed + truth.bias[5], abs=1e-6)


def test_samples_are_what_they_were_before_there_were_steps():
    config = SimulationConfig(frames=5, tracks_in_view=2, gyro_bias=(0.004, -0.003, 0.005))
    sequence, _ = simulate(config, seed=4, name="s")
    assert np.array_equal(sequence.inertial_stamp, sequence.stamp)
    # Written down before the setting came, as whatever is simulated without it must stay the same.
    first, last = sequence.twist[[0, -1]]
    assert first[:4] == pytest.approx(
        [0.00827846244929988, -0.002142834975279683, -0.0035315114971373757, 12.9580882165626], rel=1e-9
    )
    assert last[3:] == pytest.approx(
        [13.427532789827945, 0.010483067738116556, -0.0021845295627744357], rel=1e-9
    )
    assert sequence.pixels[-1] == pytest.approx(
        [238.79105815435346, 95.95211510757404, 231.66897920008319, 96.02095277132366], rel=1e-9
    )


@pytest.mark.statistical
def test_each_seed_draws_its_bias_about_the_stated_one_and_nothing_else_changes():
    short = replace(QUIET, frames=3)
    drawn = replace(short, gyro_bias_sigma=(0.02, 0.01, 0.0), velocity_bias_sigma=(0.01, 0.05, 0.02))
    sigma = np.array([0.02, 0.01, 0.0, 0.01, 0.05, 0.02])
    found = np.array([simulate(drawn, seed=seed, name="s")[1].bias for seed in range(200)])
    stated = np.array([*QUIET.gyro_bias, *QUIET.velocity_bias])
    assert np.all(np.abs(found.mean(axis=0) - stated) <= 5.0 * sigma / np.sqrt(200) + 1e-12)
    assert np.all(np.abs(found.std(axis=0) - sigma) <= 5.0 * sigma / np.sqrt(400) + 1e-12)
    one, other = simulate(drawn, seed=7, name="s")[0], simulate(short, seed=7, name="s")[0]
    assert np.array_equal(one.pixels, other.pixels)
    shift = found[7] - stated
    assert np.allclose(one.twist - other.twist, shift, atol=1e-12)
