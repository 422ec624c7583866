"""Poses that the smoothers tell again at a lag."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vislam.base.progress import Silent
from vislam.comparison.compare import run_comparison
from vislam.comparison.config import load
from vislam.comparison.open import open_dataset
from vislam.geometry import se3

CI = Path(__file__).parents[2] / "configs" / "ci.yaml"


@pytest.fixture(scope="module")
def runs():
    config = load(CI)
    simulation = replace(config.data.simulation, frames=45)
    config = replace(
        config,
        data=replace(config.data, simulation=simulation),
        estimators={
            "eks": {"gate": False},
            "isam2": {"marginals": "poses", "final_iterations": 3},
            "fixed_lag": {"lag_s": 1.0},
            "stereo_vo": {},
        },
        checks=(),
        lags=(0, 2, 10, 30),
        lag_cov_every=5,
    )
    dataset = open_dataset(config.data, seed=config.seed, held_out=config.held_out)
    found = run_comparison(config, dataset, Silent()).runs
    assert all(run.complete for run in found.values())
    return found


def apart(one, other) -> float:
    return float(np.abs(se3.local(one, other)).max())


@pytest.mark.parametrize("name", ["isam2", "fixed_lag"])
def test_the_ends_are_the_filtered_and_the_final_poses(runs, name):
    run = runs[name]
    lagged = dict(run.lagged)
    assert list(lagged) == [0, 2, 10, 30, 44]
    assert np.array_equal(lagged[0].world_T_imu, run.filtered.world_T_imu)
    assert np.array_equal(lagged[44].world_T_imu, run.final.world_T_imu)


def test_filter_and_smoother_tell_nearly_the_same_at_each_lag(runs):
    one, other = dict(runs["eks"].lagged), dict(runs["isam2"].lagged)
    for lag, poses in one.items():
        apart = np.abs(se3.local(poses.world_T_imu, other[lag].world_T_imu))
        sigma = np.sqrt(np.diagonal(poses.cov[40]))
        # Linearised elsewhere: a fraction of what they claim.
        assert (apart[40] < 0.35 * sigma).all(), lag
        both = poses.cov[5::5], other[lag].cov[5::5]
        sigmas = [np.sqrt(np.diagonal(cov, axis1=1, axis2=2)) for cov in both]
        assert np.allclose(sigmas[0], sigmas[1], rtol=0.1), lag


def test_what_has_left_a_lag_stays_what_it_was(runs):
    lagged = dict(runs["fixed_lag"].lagged)
    assert np.array_equal(lagged[30].world_T_imu[:14], lagged[44].world_T_imu[:14])
    assert np.isnan(lagged[30].cov[:14]).all()


def test_who_cannot_tell_has_none(runs):
    assert runs["stereo_vo"].lagged is None
