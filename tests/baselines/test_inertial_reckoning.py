"""Dead reckoning by raw inertia: exact without noise, consistent with it, and the twist has no part in it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests import inertial
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem
from vislam.core.estimator import find
from vislam.simulation.settings import ImuSimulation

QUIET = ImuSimulation(
    rate=1000.0,
    gyro_density=1e-9,
    accel_density=1e-9,
    gyro_walk=1e-9,
    accel_walk=1e-9,
    gyro_bias_sigma=1e-9,
    accel_bias_sigma=1e-9,
    tilt_sigma=1e-9,
    velocity_sigma=1e-9,
    gauge_sigma=1e-9,
)


def test_without_noise_it_is_where_the_body_is():
    """At 1 kHz, samples joined by straight lines are off by next to nothing over 2 s at 12.7 m/s."""
    config, dataset = inertial.drive(imu=QUIET, frames=21, tracks=5.0)
    _, run = inertial.ran("dead_reckoning", config, dataset)
    position, attitude = inertial.errors(run, dataset)
    assert position.max() < 1e-4
    assert attitude.max() < 1e-5


def test_the_twist_has_no_part_in_it():
    config, dataset = inertial.drive(tracks=5.0)
    other = replace(dataset, sequence=replace(dataset.sequence, twist=dataset.sequence.twist + 1.0))
    first, second = (inertial.ran("dead_reckoning", config, each)[1] for each in (dataset, other))
    assert np.array_equal(first.final.world_T_imu, second.final.world_T_imu)
    assert first.upright


def test_it_is_the_filter_without_a_camera():
    config, dataset = inertial.drive(tracks=5.0)
    blind = replace(dataset, sequence=dataset.sequence.select(np.zeros(dataset.sequence.observations, bool)))
    _, alone = inertial.ran("dead_reckoning", config, dataset)
    _, filtered = inertial.ran("ekf", config, blind)
    assert alone.final.world_T_imu == pytest.approx(filtered.final.world_T_imu, abs=1e-9)
    assert alone.final.covariances == pytest.approx(filtered.final.covariances, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("name", ["report_ekf", "known_map", "mapping_only"])
def test_what_is_made_of_the_twist_rejects_raw_inertia(name):
    config, dataset = inertial.drive(tracks=5.0)
    options = {"map": "nowhere.npz"} if name == "known_map" else {}
    with pytest.raises(ConfigError, match=f"estimators.{name}: expected motion: odometry"):
        find(name)(make_problem(config, dataset), options)


def test_options_of_the_twist_are_rejected():
    config, dataset = inertial.drive(tracks=5.0)
    with pytest.raises(ConfigError, match=r"dead_reckoning\.integration: expected motion: odometry"):
        find("dead_reckoning")(make_problem(config, dataset), {"integration": "first"})


@pytest.mark.statistical
def test_errors_over_drives_are_those_of_its_covariance():
    """NEES of the last pose of 60 drives; a mean of 360 degrees of freedom, 99.9 % two-sided."""
    found = []
    for seed in range(60):
        config, dataset = inertial.drive(seed=seed, frames=11, tracks=5.0)
        _, run = inertial.ran("dead_reckoning", config, dataset)
        error = inertial.pose_error(run, dataset)[-1]
        found.append(error @ np.linalg.solve(run.final.covariances[-1], error))
    assert chi2.ppf(0.0005, 360) < sum(found) < chi2.ppf(0.9995, 360)
