"""Poses as known at a lag: carried forward with the filter, they are those of the backward pass from
there."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config
from vislam.comparison.open import Dataset
from vislam.core.run import Run
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.loop import run

LAGS = (0, 1, 2, 5, 10, 23)
FORMS = [("standard", "point"), ("fej", "anchored_uvd"), ("invariant", "anchored_uvd")]
MOTIONS = {"odometry": {}, "smooth": {"acceleration_density": (0.1, 0.1, 0.1, 1.0, 1.0, 1.0)}}


def made(dataset: Dataset, config: Config, *, smoothed: bool = True, **options) -> Run:
    problem = make_problem(config, dataset)
    estimator = EkfEstimator(problem, EkfOptions(smoothed=smoothed, track_errors="states", **options))
    found = run(estimator, dataset.sequence, pixel_sigma(config, dataset), name="eks")
    assert found.complete, found.log.traceback
    return found


def first_frames(dataset: Dataset, count: int) -> Dataset:
    sequence = dataset.sequence
    kept = replace(sequence.select(sequence.frame_of < count))
    short = replace(kept, stamp=kept.stamp[:count], offset=kept.offset[: count + 1])
    return replace(dataset, sequence=short)


@pytest.mark.parametrize(("error", "landmarks"), FORMS)
@pytest.mark.parametrize("motion", MOTIONS)
def test_a_lag_is_the_smoother_of_the_drive_cut_there(short, short_config, error, landmarks, motion):
    config = replace(short_config, noise=replace(short_config.noise, **MOTIONS[motion]))
    asked = replace(config, lags=LAGS, lag_cov_every=1)
    found = made(short, asked, error=error, landmarks=landmarks)
    lagged = dict(found.lagged)
    assert list(lagged) == [*LAGS, 24]
    assert np.array_equal(lagged[0].world_T_imu, found.filtered.world_T_imu)
    assert np.array_equal(lagged[0].cov, found.filtered.cov)
    assert np.array_equal(lagged[24].world_T_imu, found.smoothed.world_T_imu)
    # All but the first frame, which the last one comes too late for.
    assert np.allclose(lagged[23].world_T_imu[1:], found.smoothed.world_T_imu[1:], atol=1e-8)
    assert np.allclose(lagged[23].cov[1:], found.smoothed.cov[1:], rtol=1e-8, atol=1e-12)
    for end in (8, 17):
        cut = made(first_frames(short, end + 1), config, error=error, landmarks=landmarks).smoothed
        for lag in (1, 2, 5):
            assert np.allclose(lagged[lag].world_T_imu[end - lag], cut.world_T_imu[end - lag], atol=1e-8)
            assert np.allclose(lagged[lag].cov[end - lag], cut.cov[end - lag], rtol=1e-8, atol=1e-12)


def test_asking_changes_nothing_that_is_estimated(short, short_config):
    asked = replace(short_config, lags=(0, 3), lag_cov_every=7)
    plain, found = made(short, short_config, smoothed=False), made(short, asked, smoothed=False)
    assert plain.lagged is None
    assert found.smoothed is None
    assert np.array_equal(plain.filtered.world_T_imu, found.filtered.world_T_imu)
    assert np.array_equal(plain.map.points_world, found.map.points_world)
    every = made(short, short_config).smoothed
    assert np.allclose(dict(found.lagged)[24].world_T_imu, every.world_T_imu, atol=1e-8)
    known = np.isfinite(dict(found.lagged)[3].cov).all(axis=(1, 2))
    assert np.array_equal(np.flatnonzero(known), np.arange(0, 25, 7))


def test_without_the_way_back_there_are_lags_and_no_end(short, short_config):
    asked = replace(short_config, lags=(0, 3))
    found = made(short, asked, smoothed=False, marginalised_landmarks="filtered")
    assert list(dict(found.lagged)) == [0, 3]
