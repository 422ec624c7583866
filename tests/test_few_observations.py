"""Few observations: five in view, tracks of one view, none for a while or at all; estimators stay sound."""

from dataclasses import replace

import numpy as np
import pytest

from tests import inertial
from tests.smoother.drives import drive
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.core.estimator import find
from vislam.estimators.loop import run
from vislam.estimators.smoother.engine import WholeGraph
from vislam.estimators.smoother.tree import IndeterminateError

NAMES = ("ekf", "ekf_invariant", "ekf_fej", "eks", "msckf", "isam2", "fixed_lag", "batch")


def five_in_view(sequence):
    place = np.arange(sequence.observations) - sequence.offset[sequence.frame_of]
    return place < 5


def one_view_each(sequence):
    return np.arange(sequence.observations) == sequence.first_rows()


def none_in_the_middle(sequence):
    return (sequence.frame_of < 4) | (sequence.frame_of > 20)


def none_at_all(sequence):
    return np.zeros(sequence.observations, bool)


@pytest.fixture(scope="module", params=[five_in_view, one_view_each, none_in_the_middle, none_at_all])
def sparse(request, short):
    return replace(short, sequence=short.sequence.select(request.param(short.sequence)))


def error(found, dataset):
    return float(np.abs(found.final.world_T_imu[:, :3, 3] - dataset.reference.position).max())


@pytest.mark.parametrize("name", NAMES)
def test_every_estimator_is_near_dead_reckoning_or_better(name, sparse, short_config):
    problem, sigma = make_problem(short_config, sparse), pixel_sigma(short_config, sparse)
    found = run(find(name)(problem, {}), sparse.sequence, sigma, name=name)
    alone = run(find("dead_reckoning")(problem, {}), sparse.sequence, sigma, name="alone")
    assert found.complete, found.log.error
    assert error(found, sparse) < 1.5 * error(alone, sparse) + 0.05


@pytest.fixture(scope="module")
def dark():
    """Five in view in the first and the last ten frames, and a hundred without any in between.

    The bias is known: else what ten frames say of it is extrapolated over the rest.
    """
    config, dataset = drive(seed=4, frames=120, tracks_in_view=5.0, pixel=0.3, gyro=0.002, velocity=0.02)
    config = replace(config, noise=replace(config.noise, bias_sigma=(1e-6,) * 6, bias_walk=(1e-9,) * 6))
    frame = dataset.sequence.frame_of
    return config, replace(dataset, sequence=dataset.sequence.select((frame < 10) | (frame >= 110)))


@pytest.mark.parametrize("name", NAMES)
def test_a_hundred_steps_without_any_are_survived(name, dark):
    config, dataset = dark
    problem, sigma = make_problem(config, dataset), pixel_sigma(config, dataset)
    found = run(find(name)(problem, {}), dataset.sequence, sigma, name=name)
    alone = run(find("dead_reckoning")(problem, {}), dataset.sequence, sigma, name="alone")
    assert found.complete, found.log.error
    assert found.used[-1]
    assert error(found, dataset) < 1.5 * error(alone, dataset) + 0.05


RAW = ("ekf", "ekf_invariant", "eks", "msckf", "isam2", "fixed_lag", "batch")


@pytest.fixture(scope="module", params=[five_in_view, one_view_each, none_in_the_middle, none_at_all])
def sparse_inertia(request):
    config, dataset = inertial.drive(seed=2, frames=25, tracks=8.0)
    dataset = replace(dataset, sequence=dataset.sequence.select(request.param(dataset.sequence)))
    alone = inertial.ran("dead_reckoning", config, dataset)[1]
    return config, dataset, inertial.errors(alone, dataset)[0].max()


@pytest.mark.parametrize("name", RAW)
def test_by_raw_inertia_they_are_near_it_alone_or_better(name, sparse_inertia):
    config, dataset, alone = sparse_inertia
    found = inertial.ran(name, config, dataset)[1]
    assert found.complete, found.log.error
    assert inertial.errors(found, dataset)[0].max() < 1.5 * alone + 0.05


def test_a_covariance_that_is_refused_does_not_end_the_run(short, short_config, monkeypatch):
    def refuse(self, key):
        raise IndeterminateError("indeterminate at v1")

    monkeypatch.setattr(WholeGraph, "covariance", refuse)
    problem, sigma = make_problem(short_config, short), pixel_sigma(short_config, short)
    found = run(find("isam2")(problem, {"pose_cov_every": 1}), short.sequence, sigma, name="isam2")
    assert found.complete
    assert found.log.counts["covariances_failed"] == len(short.sequence)
    assert np.isnan(found.filtered.covariances).all()
