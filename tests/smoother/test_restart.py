"""The last resort: an estimate worse than the inertial path is re-initialised, by isam2 and batch alike."""

import gtsam
import numpy as np
import pytest

from tests.smoother.drives import BUILD, ate, drive
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.estimators.loop import run
from vislam.estimators.smoother import incremental
from vislam.estimators.smoother.keys import X


@pytest.fixture(scope="module")
def simulated():
    return drive(seed=3, frames=30, tracks_in_view=12)


def bent(values, rng):
    """Values whose poses are metres and a radian off."""
    moved = gtsam.Values(values)
    for k in range(1, 30):
        off = gtsam.Pose3.Expmap(np.concatenate([rng.normal(0, 1.0, 3), rng.normal(0, 5.0, 3)]))
        moved.update(X(k), values.atPose3(X(k)).compose(off))
    return moved


@pytest.mark.parametrize("name", ["isam2", "batch"])
def test_a_diverged_estimate_is_found_anew(simulated, name, monkeypatch, rng):
    config, dataset = simulated
    sigma = pixel_sigma(config, dataset)
    plain = run(BUILD[name](make_problem(config, dataset), {}), dataset.sequence, sigma, name=name)
    assert not any("re-initialised" in event for event in plain.log.events)
    asked = []
    restarted = incremental.restarted

    def after_a_fall(drive, values, *rest):
        asked.append(restarted(drive, values, *rest))
        return restarted(drive, bent(values, rng), *rest)

    monkeypatch.setattr(incremental, "restarted", after_a_fall)
    fallen = run(BUILD[name](make_problem(config, dataset), {}), dataset.sequence, sigma, name=name)
    assert asked == [None]
    assert any("re-initialised" in event for event in fallen.log.events)
    assert abs(ate(fallen.final.world_T_imu, dataset) - ate(plain.final.world_T_imu, dataset)) < 1e-3
