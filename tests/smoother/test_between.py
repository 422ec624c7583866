"""Motion as one measured step a frame: what it is of the form with the bias, and what it cannot take."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from tests.smoother.drives import BUILD, ate, drive, gap, member
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem
from vislam.comparison.config import VerticalVelocityConfig
from vislam.core.estimator import find
from vislam.core.step import TWIST_BIAS
from vislam.estimators.smoother.keys import H, X

GYRO_BIAS = (0.003, -0.002, 0.004)
KNOWN = {"bias_mean": (*GYRO_BIAS, 0.0, 0.0, 0.0), "bias_sigma": (1e-9,) * 6, "bias_walk": (1e-9,) * 6}


@pytest.fixture(scope="module")
def simulated():
    return drive(seed=5, frames=40, tracks_in_view=25, gyro_bias=GYRO_BIAS)


def with_noise(simulated, **noise):
    config, dataset = simulated
    level = np.zeros_like(dataset.sequence.vertical_velocity)
    dataset = replace(dataset, sequence=replace(dataset.sequence, vertical_velocity=level))
    return replace(config, noise=replace(config.noise, **noise)), dataset


@pytest.mark.parametrize("climb", [None, VerticalVelocityConfig()])
def test_it_is_the_form_with_the_bias_where_the_bias_is_known(simulated, climb):
    config, dataset = with_noise(simulated, **KNOWN, vertical_velocity=climb)
    between = member("batch", config, dataset, motion="between")
    # Variables that are known to 1e-9 beside others need QR.
    bias = member("batch", config, dataset, factorization="qr")
    assert between.complete
    assert bias.complete
    assert np.array_equal(between.used, bias.used)
    # The covariance of a step is taken where it was measured, and not where it is estimated.
    angle, distance = gap(between.final.world_T_imu, bias.final.world_T_imu)
    assert angle < 1e-8
    assert distance < 1e-6
    zero = member("batch", *with_noise(simulated, vertical_velocity=climb), motion="between")
    assert gap(between.final.world_T_imu, zero.final.world_T_imu)[0] > 1e-4


def test_there_is_a_between_factor_a_step_and_no_variable_but_poses_heights_and_landmarks(simulated):
    config, dataset = with_noise(simulated, vertical_velocity=VerticalVelocityConfig())
    estimator = BUILD["isam2_between"](make_problem(config, dataset), {})
    frames = list(dataset.sequence.frames(np.full((dataset.sequence.observations, 3), 0.3)))
    for frame in frames:
        estimator.process(frame)
    held = estimator._solver.engine.factors().values()
    steps = [factor for factor in held if isinstance(factor, gtsam.BetweenFactorPose3)]
    assert [list(factor.keys()) for factor in steps] == [[X(k), X(k + 1)] for k in range(len(frames) - 1)]
    keys = list(estimator._solver.engine.estimate().keys())
    assert not {chr(gtsam.symbolChr(key)) for key in keys} & set("wvbca")
    assert {H(k) for k in range(len(frames))} <= set(keys)


def test_the_bias_is_what_the_prior_says_and_has_no_standard_deviation(simulated):
    config, dataset = with_noise(simulated, bias_mean=KNOWN["bias_mean"])
    run = member("isam2_between", config, dataset, pose_cov_every=1)
    assert run.complete
    assert np.array_equal(run.states[TWIST_BIAS].value, np.tile(KNOWN["bias_mean"], (40, 1)))
    assert np.isnan(run.states[TWIST_BIAS].sigma).all()
    assert ate(run.final.world_T_imu, dataset) < 0.5


@pytest.mark.parametrize("name", ["fixed_lag", "batch_gnc"])
def test_other_members_take_it_too(simulated, name):
    run = member(name, *with_noise(simulated, **KNOWN), motion="between")
    assert run.complete
    assert run.log.counts["recoveries"] == 0


UNMET = {
    "clock_sigma to 0": {"clock_sigma": 0.01},
    "velocity_direction_sigma to 0": {"velocity_direction_sigma": 0.01},
    "acceleration_density to null": {"acceleration_density": (1.0,) * 6},
}


@pytest.mark.parametrize("remedy", UNMET)
def test_what_needs_a_variable_that_is_not_there_is_refused_with_one_line(simulated, remedy):
    problem = make_problem(*with_noise(simulated, **UNMET[remedy]))
    line = rf"^estimators\.isam2_between: .*; set noise\.{remedy}, or motion to bias$"
    with pytest.raises(ConfigError, match=line):
        BUILD["isam2_between"](problem, {})


def test_it_is_found_by_its_module(simulated):
    build = find("vislam.estimators.smoother.family:build_between")
    estimator = build(make_problem(*simulated), {"relinearize_every": 3})
    assert estimator.information["twist bias"] == "assumed known"
