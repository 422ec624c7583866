"""Levenberg-Marquardt by our own normal equations: the steps of GTSAM's, and its optimum."""

import itertools
from dataclasses import replace
from pathlib import Path

import gtsam
import numpy as np
import pytest

from tests.conftest import recorded
from tests.smoother.drives import BUILD, drive, gap, member
from tests.smoother.ended import CASES, ended
from vislam.base.errors import ConfigError
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import load
from vislam.comparison.open import open_dataset
from vislam.estimators.loop import run
from vislam.estimators.smoother.descent import Budget
from vislam.estimators.smoother.descent import descend as gtsams
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.schur_descent import descend, first_step, iterate

CONFIGS = Path(__file__).parents[2] / "configs"


def apart(held, one, other):
    """Largest difference of two estimates: of poses [rad], [m], and of landmarks [m]."""
    points = [np.array([values.atPoint3(track.key) for track in held.tracks]) for values in (one, other)]
    return (*gap(held.poses(one), held.poses(other)), np.abs(points[0] - points[1]).max())


@pytest.mark.parametrize("name", CASES)
def test_the_optimum_is_gtsams(name):
    held, values = ended(name)
    ours = descend(held.objective(values), values, budget=Budget(300))
    # Its Cholesky refuses errors that walk.
    theirs = gtsams(held.graph(), values, solver="qr", budget=Budget(300))
    assert not ours.cut
    assert ours.cost < held.graph().error(values)
    assert np.isclose(ours.cost, held.graph().error(ours.values), rtol=1e-12)
    assert max(apart(held, ours.values, theirs.values)) < 1e-6


def perturbed(held, values, rng, *, turn, move):
    """Values whose poses are off, so that Gauss-Newton alone raises the cost."""
    moved = gtsam.Values(values)
    for k in range(1, len(held.frames)):
        off = np.concatenate([rng.normal(0.0, turn, 3), rng.normal(0.0, move, 3)])
        moved.update(X(k), values.atPose3(X(k)).retract(off))
    return moved


@pytest.mark.parametrize(
    ("name", "turn"), [("short", 0.3), ("short", 0.5), ("kernel", 0.5), ("inertial", 0.3)]
)
def test_from_far_away_each_iteration_is_gtsams_with_rejected_steps_and_all(name, turn):
    held, values = ended(name)
    start = perturbed(held, values, np.random.default_rng(0), turn=turn, move=10.0 * turn)
    solver = gtsam.LevenbergMarquardtOptimizer(held.graph(), start, gtsam.LevenbergMarquardtParams())
    objective, rejected = held.objective(values), 0
    at = first_step(objective, start)
    for _ in range(6):
        before = at.damping
        solver.iterate()
        at = iterate(objective, at)
        # Where a cost of 1e10 is left of 1e11, so are the digits of normal equations.
        assert np.isclose(at.cost, solver.error(), rtol=1e-5)
        assert np.isclose(at.damping, solver.lambda_(), rtol=1e-9)
        rejected += at.damping > before
    assert rejected or name == "kernel"


def test_where_no_damping_lowers_the_cost_the_estimate_stays(monkeypatch):
    held, values = ended("short")
    objective = held.objective(values)
    at = first_step(objective, values)
    costs = itertools.count(at.cost + 1.0)
    monkeypatch.setattr(objective, "cost", lambda _: next(costs))
    found = iterate(objective, at)
    assert found.estimate is at.estimate
    assert found.cost == at.cost
    assert found.damping >= 1e5


@pytest.mark.parametrize("options", [{}, {"motion": "between"}])
def test_batch_schur_is_batch(options):
    config, dataset = drive(seed=3, frames=40, tracks_in_view=15)
    one, other = (
        member(name, config, dataset, marginals="all", **options) for name in ("batch", "batch_schur")
    )
    assert max(gap(one.final.world_T_imu, other.final.world_T_imu)) < 1e-6
    assert np.abs(one.landmarks.points_world - other.landmarks.points_world).max() < 1e-6
    assert np.isclose(one.fit[0], other.fit[0], rtol=1e-9)
    assert one.log.counts["optimisation_rounds"] == other.log.counts["optimisation_rounds"]


def both(config, dataset):
    runs = []
    for name in ("batch", "batch_schur"):
        estimator = BUILD[name](make_problem(config, dataset), {})
        runs.append(run(estimator, dataset.sequence, pixel_sigma(config, dataset), name=name))
    return runs


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "file"),
    [("ds3", "03.npz"), ("battle/kitti_0036", "clement2015/2011_09_26_drive_0036_sync_KLT.mat")],
)
def test_on_recorded_data_too(name, file):
    folder = recorded("03.npz").parent
    recorded(file)
    config = load(CONFIGS / f"{name}.yaml")
    dataset = open_dataset(config.data, seed=0, data_dir=folder)
    one, other = both(config, replace(dataset, sequence=dataset.sequence.first(200)))
    assert max(gap(one.final.world_T_imu, other.final.world_T_imu)) < 1e-6
    assert np.abs(one.landmarks.points_world - other.landmarks.points_world).max() < 1e-6


def test_pixel_errors_are_refused_by_name(short, short_config):
    problem = replace(make_problem(short_config, short), disparity_offset_sigma=0.3)
    with pytest.raises(ConfigError, match=r"batch_schur: optimiser: schur .* disparity offset .* gtsam"):
        BUILD["batch_schur"](problem, {})
    assert BUILD["batch_schur"](problem, {"optimiser": "gtsam"})
