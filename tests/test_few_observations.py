"""Few observations: five in view, tracks of one view, none for a while or at all; estimators stay sound."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.core.estimator import find
from vislam.estimators.loop import run
from vislam.estimators.smoother.engine import IndeterminateError, WholeGraph

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


def test_a_covariance_that_is_refused_does_not_end_the_run(short, short_config, monkeypatch):
    def refuse(self, key):
        raise IndeterminateError("indeterminate at v1")

    monkeypatch.setattr(WholeGraph, "covariance", refuse)
    problem, sigma = make_problem(short_config, short), pixel_sigma(short_config, short)
    found = run(find("isam2")(problem, {"pose_cov_every": 1}), short.sequence, sigma, name="isam2")
    assert found.complete
    assert found.log.counts["covariances_failed"] == len(short.sequence)
    assert np.isnan(found.filtered.covariances).all()
