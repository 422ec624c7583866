"""The end of iSAM2 by our own normal equations, beside GTSAM's update of the whole tree."""

from dataclasses import replace

import numpy as np
import pytest

from tests.smoother.drives import drive, gap, member
from vislam.estimators.smoother import ending, segments
from vislam.estimators.smoother.system import NormalEquations

SHORT = {"tracks_in_view": 12, "loss_probability": 0.2}


@pytest.fixture(params=["whole", "cut"])
def tree(request, monkeypatch):
    """Whether the end has the whole tree, or old variables have left it."""
    monkeypatch.setattr(segments, "_EVERY", 12 if request.param == "cut" else 10**6)
    return request.param


def ends(monkeypatch, config, dataset, **options):
    """Runs that end by our own normal equations, and by GTSAM's tree."""
    ours = member("isam2", config, dataset, **options)
    monkeypatch.setattr(ending, "_WIDEST", 0)
    return ours, member("isam2", config, dataset, **options)


def test_it_lowers_the_cost_as_far_as_the_tree_does(monkeypatch, tree):
    config, dataset = drive(seed=3, frames=50, **SHORT)
    ours, theirs = ends(monkeypatch, config, dataset, marginals="poses")
    sigma = np.sqrt(np.diagonal(theirs.smoothed.covariances, axis1=1, axis2=2))
    turned, moved = gap(ours.smoothed.world_T_imu, theirs.smoothed.world_T_imu)
    # The tree leaves what moves by less than its thresholds where it was linearised.
    assert turned < 0.05 * np.median(sigma[:, :3])
    assert moved < 0.05 * np.median(sigma[:, 3:])
    assert ours.fit[1] == theirs.fit[1]
    assert ours.fit[0] < theirs.fit[0] + 1e-3
    assert np.array_equal(ours.filtered.world_T_imu, theirs.filtered.world_T_imu)


def test_after_some_iterations_it_is_the_optimum(monkeypatch, tree):
    config, dataset = drive(seed=4, frames=40, **SHORT)
    run = member("isam2", config, dataset, final_iterations=8)
    optimum = member("batch", config, dataset)
    assert max(gap(run.smoothed.world_T_imu, optimum.smoothed.world_T_imu)) < 1e-5
    assert run.fit[0] == pytest.approx(optimum.fit[0], rel=1e-7)
    assert run.log.counts["final_iterations_undone"] == 0


def test_what_has_left_the_tree_does_not_come_back(monkeypatch):
    monkeypatch.setattr(segments, "_EVERY", 12)
    config, dataset = drive(seed=3, frames=50, **SHORT)
    joined = []
    real = segments.Segments.join
    monkeypatch.setattr(segments.Segments, "join", lambda self, *last: joined.append(1) or real(self, *last))
    member("isam2", config, dataset)
    assert not joined
    monkeypatch.setattr(ending, "_WIDEST", 0)
    member("isam2", config, dataset)
    assert joined


def test_equations_that_cannot_be_solved_leave_the_estimate_that_there_was(monkeypatch, tree):
    config, dataset = drive(seed=3, frames=50, **SHORT)

    def fail(self, damping=0.0):
        raise np.linalg.LinAlgError

    as_is = member("isam2", config, dataset, final="as_is")
    monkeypatch.setattr(NormalEquations, "factorised", fail)
    run = member("isam2", config, dataset)
    assert run.complete
    assert run.log.counts["final_iterations_undone"] == 1
    assert max(gap(run.smoothed.world_T_imu, as_is.smoothed.world_T_imu)) < 1e-9


def test_where_pixels_have_shared_errors_it_is_the_trees(monkeypatch):
    config, dataset = drive(seed=3, frames=30, **SHORT)
    config = replace(config, noise=replace(config.noise, disparity_offset_sigma_px=0.5))
    ours, theirs = ends(monkeypatch, config, dataset)
    assert np.array_equal(ours.smoothed.world_T_imu, theirs.smoothed.world_T_imu)


def test_nothing_is_relinearised_where_nothing_is_to_be(monkeypatch):
    config, dataset = drive(seed=3, frames=30, **SHORT)
    ours, theirs = ends(monkeypatch, config, dataset, relinearize_every=0)
    assert np.array_equal(ours.smoothed.world_T_imu, theirs.smoothed.world_T_imu)
