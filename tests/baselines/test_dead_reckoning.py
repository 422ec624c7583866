"""Which twist dead reckoning integrates, and what it adds to the covariance."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem
from vislam.comparison.config import Config, VerticalVelocityConfig
from vislam.comparison.open import Dataset, open_dataset
from vislam.estimators import loop
from vislam.geometry import se3
from vislam_baselines import dead_reckoning
from vislam_baselines.twist import step_twist


def reckon(short: Dataset, short_config: Config, **options):
    built = dead_reckoning.build(make_problem(short_config, short), options)
    sigma = np.ones((short.sequence.observations, 3))
    return loop.run(built, short.sequence, sigma, name="dead_reckoning")


def test_the_first_twist_is_the_sample_at_the_start_of_the_step(short: Dataset):
    sequence = short.sequence
    assert np.array_equal(sequence.stamp, sequence.inertial_stamp)
    frames = list(sequence.frames(np.ones((sequence.observations, 3))))
    first = np.array([step_twist(frame, "first") for frame in frames[1:]])
    assert first == pytest.approx(sequence.twist[:-1], abs=1e-12)
    mean = np.array([step_twist(frame, "mean") for frame in frames[1:]])
    assert mean == pytest.approx(0.5 * (sequence.twist[:-1] + sequence.twist[1:]), abs=1e-12)


def test_the_report_s_integration_is_a_product_of_exponentials(short: Dataset, short_config: Config):
    sequence = short.sequence
    pose = np.eye(4)
    for k in range(len(sequence) - 1):
        pose = pose @ se3.exp((sequence.stamp[k + 1] - sequence.stamp[k]) * sequence.twist[k])
    first = reckon(short, short_config, integration="first").final.world_T_imu[-1]
    assert first == pytest.approx(pose, abs=1e-10)
    assert np.abs(reckon(short, short_config).final.world_T_imu[-1] - pose).max() > 1e-3


def test_a_given_variance_is_added_by_the_step(short: Dataset, short_config: Config):
    variance = np.array([0.1, 0.2, 0.3, 1.0, 2.0, 3.0])
    run = reckon(short, short_config, motion_variance=tuple(variance))
    cov = np.diag(np.square(short_config.noise.first_pose_sigma))
    for k in range(1, len(short.sequence)):
        carry = se3.adjoint(se3.inverse(run.final.world_T_imu[k]) @ run.final.world_T_imu[k - 1])
        cov = carry @ cov @ carry.T + np.diag(variance)
        assert run.final.covariances[k] == pytest.approx(cov, rel=1e-9)


def test_a_variance_below_zero_is_refused(short: Dataset, short_config: Config):
    with pytest.raises(ConfigError, match=r"estimators\.dead_reckoning\.motion_variance\.1"):
        reckon(short, short_config, motion_variance=(0.1, -0.1, 0.1, 1.0, 1.0, 1.0))


def test_the_vertical_velocity_holds_the_height(short_config: Config):
    """As it does in the fused estimators: without it a bias of the pitch rate takes the path off the
    ground."""
    simulation = replace(
        short_config.data.simulation, frames=150, navigation_frame_velocity=True, gyro_bias=(0.0, 0.01, 0.0)
    )
    repair = replace(short_config.data.repair, navigation_frame_velocity=True)
    data = replace(short_config.data, simulation=simulation, repair=repair)
    dataset, off = open_dataset(data, seed=3), []
    for rise in (None, VerticalVelocityConfig()):
        config = replace(short_config, data=data, noise=replace(short_config.noise, vertical_velocity=rise))
        run = reckon(dataset, config)
        risen = dataset.reference.pose[-1, 2, 3] - dataset.reference.pose[0, 2, 3]
        off.append(abs(run.final.world_T_imu[-1, 2, 3] - risen))
    assert off[0] > 5.0
    assert off[1] < 0.3
