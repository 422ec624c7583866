"""Noise densities of raw inertia by likelihood, and what of a calibration is another with it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.inertial import IMU, drive
from vislam.calibration import calibrate, parameters
from vislam.calibration.shared import with_shared
from vislam.calibration.tables import tables

ROOM = {"path": "room", "speed": 1.5, "depth_min": 1.5, "depth_max": 8.0, "outlier_probability": 0.0}
PLANTED = {"noise.imu.gyro_density": IMU.gyro_density, "noise.imu.accel_density": IMU.accel_density}


def misstated(seed, *, frames, gyro=3.0, accel=1.0 / 3.0, **settings):
    """A drive whose config has other densities, its reference taken away."""
    config, dataset = drive(seed=seed, frames=frames, tracks=15.0, **settings)
    imu = config.noise.imu
    stated = replace(imu, gyro_density=gyro * imu.gyro_density, accel_density=accel * imu.accel_density)
    return replace(config, noise=replace(config.noise, imu=stated)), replace(dataset, reference=None)


def levels(config):
    return [one for one in parameters(config) if one.name in (*PLANTED, "noise.pixel_sigma_px")]


def test_the_densities_take_the_place_of_side_slip_and_heave():
    config, _ = misstated(1, frames=25)
    names = {one.name for one in parameters(config)}
    assert set(PLANTED) < names
    assert not any("twist_density" in name for name in names)
    more = {one.name for one in parameters(config, inertial=True)} - names
    assert more == {"noise.imu.gyro_walk", "noise.imu.accel_walk"}


@pytest.mark.parametrize("name", ["gyro_density", "accel_density", "gyro_walk", "accel_walk"])
def test_a_level_is_read_where_it_is_written(name):
    config, _ = misstated(1, frames=25)
    item = next(one for one in parameters(config, inertial=True) if one.name == f"noise.imu.{name}")
    changed = item.write(config, 0.5)
    assert item.read(changed) == getattr(changed.noise.imu, name) == 0.5
    assert item.write(changed, item.read(config)) == config


def test_errors_of_a_recorded_velocity_are_no_states_beside_raw_inertia():
    config, _ = misstated(1, frames=25)
    shared = with_shared(config).noise
    assert (shared.clock_sigma, shared.velocity_direction_sigma) == (0.0, 0.0)
    assert shared.camera_rotation_sigma > 0.0


@pytest.mark.slow
@pytest.mark.parametrize(("settings", "seed"), [(ROOM, 1), (ROOM, 2), ({}, 3)])
def test_planted_densities_are_recovered_within_their_intervals(settings, seed):
    config, dataset = misstated(seed, frames=60, **settings)
    result = calibrate(config, dataset, levels(config))
    assert result.best is not None
    for one in result.parameters:
        planted = PLANTED.get(one.parameter.name)
        if planted is not None:
            # Intervals of 95 %, of six: half as wide again.
            off = abs(np.log(one.value / planted))
            assert off < 1.5 * np.log(one.high / one.value), one
    found, _ = tables(result, config, name="drive")
    assert "bias, accelerometer z" in {row[0] for row in found.rows}


@pytest.mark.slow
def test_densities_that_are_right_are_not_made_worse():
    config, dataset = misstated(4, frames=60, gyro=1.0, accel=1.0, **ROOM)
    result = calibrate(config, dataset, levels(config))
    for one in result.parameters:
        assert one.value == pytest.approx(one.before, rel=0.6), one
    if result.best is None:
        assert result.config == config
