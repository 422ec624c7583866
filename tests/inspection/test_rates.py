"""Rates about level axes: told from rates about the body's, and rotated into them."""

from dataclasses import replace

import numpy as np
import pytest

from tests.inspection.test_inspection import CLEAN, inspected
from vislam.base.errors import DataError
from vislam.comparison.config import DataConfig
from vislam.comparison.open import open_dataset
from vislam.repair import RepairConfig
from vislam.repair.inertial import NavigationFrameRates, Tilt
from vislam.simulation import SimulationConfig

CHECK, PATH = "axes of the rates", "data.repair.navigation_frame_rates"
HILLY = replace(CLEAN, frames=300, hills_m=15.0)
LEVEL = replace(HILLY, navigation_frame_rates=True)
QUIET = SimulationConfig(frames=80, tracks_in_view=5, hills_m=15.0, gyro_sigma=0.0, velocity_sigma=0.0)


def simulated(config, *, seed=1):
    return open_dataset(DataConfig(simulation=config), seed=seed)


def first_tilt(dataset):
    """Roll and pitch of the body at the first frame."""
    down_the_rows = dataset.reference.pose[0, 2, :3]
    return np.arctan2(down_the_rows[1], down_the_rows[2]), -np.arcsin(down_the_rows[0])


@pytest.mark.parametrize("noise", ["sample", "step"])
@pytest.mark.parametrize("bias", [(0.0, 0.0, 0.0), (0.01, -0.02, 0.03)])
def test_the_rates_of_the_body_are_found_again(noise, bias):
    config = replace(QUIET, gyro_bias=bias, inertial_noise=noise)
    body = simulated(config)
    roll, pitch = first_tilt(body)
    assert abs(pitch) > 0.01
    level = simulated(replace(config, navigation_frame_rates=True)).sequence
    away = np.abs(level.twist - body.sequence.twist)[:, :3].max()
    found = NavigationFrameRates(roll=float(roll), pitch=float(pitch), bias=bias).apply(level)
    assert away > 2e-3
    assert np.abs(found.twist - body.sequence.twist).max() < 0.05 * away
    np.testing.assert_array_equal(found.twist[:, 3:], level.twist[:, 3:])


def test_tilt_is_the_integral_of_level_rates():
    stamp = np.linspace(0.0, 20.0, 4001)
    roll, pitch = 0.3 * np.sin(0.7 * stamp), 0.4 * np.cos(0.5 * stamp)
    rolling, pitching = 0.21 * np.cos(0.7 * stamp), -0.2 * np.sin(0.5 * stamp)
    turning = 0.3 * np.cos(0.2 * stamp)
    level = np.column_stack([rolling * np.cos(pitch), pitching, turning - rolling * np.sin(pitch)])
    tilt = Tilt.integrated(level, stamp, roll=roll[0], pitch=pitch[0])
    np.testing.assert_allclose(tilt.roll, roll, atol=1e-6)
    np.testing.assert_allclose(tilt.pitch, pitch, atol=1e-6)
    # Rates about the body's axes of heading, pitch and roll, turned in this order.
    body = np.column_stack(
        [
            rolling - turning * np.sin(pitch),
            pitching * np.cos(roll) + turning * np.cos(pitch) * np.sin(roll),
            turning * np.cos(pitch) * np.cos(roll) - pitching * np.sin(roll),
        ]
    )
    np.testing.assert_allclose(tilt.in_body(level), body, atol=1e-6)


def test_a_body_that_would_stand_on_its_nose_is_refused():
    sequence = simulated(replace(QUIET, gyro_bias=(0.0, 0.3, 0.0))).sequence
    with pytest.raises(DataError, match=r"pitches by less than 72 deg, got 72 deg after 4\.\d s; switch"):
        NavigationFrameRates().apply(sequence)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_rates_about_level_axes_are_found_with_the_tilt(seed):
    finding = inspected(LEVEL, seed=seed).finding(CHECK)
    assert finding.verdict == "fault", finding.text
    for measured, value in zip(finding.measured, first_tilt(simulated(LEVEL, seed=seed)), strict=True):
        assert abs(measured.value - value) < 4.0 * measured.sigma, str(measured)
    step = NavigationFrameRates(**finding.proposal[PATH])
    again = inspected(LEVEL, seed=seed, repair=RepairConfig(navigation_frame_rates=step)).finding(CHECK)
    assert again.verdict == "ok"


@pytest.mark.slow
def test_a_mounting_that_is_off_is_not_taken_for_level_axes():
    finding = inspected(replace(HILLY, camera_rotation=(0.03, -0.02, 0.01)), seed=1).finding(CHECK)
    assert finding.verdict == "ok", finding.text
    assert "constant rotation" in finding.text


@pytest.mark.slow
def test_level_axes_that_are_configured_and_are_none_are_a_fault():
    steps = RepairConfig(navigation_frame_rates=NavigationFrameRates())
    finding = inspected(HILLY, seed=1, repair=steps).finding(CHECK)
    assert finding.verdict == "fault"
    assert finding.proposal == {PATH: None}
