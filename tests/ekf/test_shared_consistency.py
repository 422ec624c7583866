"""Errors that all tracks share, drawn from their priors: who estimates them is as far off as it says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.conftest import from_first
from tests.shared_errors import SIGMA, every_shared_error
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import DataConfig
from vislam.comparison.open import open_dataset
from vislam.core.estimator import find
from vislam.estimators.loop import run
from vislam.geometry import se3
from vislam.models.shared_errors import SIZES, prior_name
from vislam.repair import RepairConfig
from vislam.simulation import simulate

SEEDS = range(16)
FALSE_ALARM = 1e-3
"""Of each of the tests, if the estimator is consistent."""
DRAWN = {**SIGMA, "clock": 0.002}
"""Standard deviations, of which the simulation and the estimators are told the same. A clock offset also
mixes the noise of neighbouring samples, which no estimator models: it is small here, and so is that noise."""


def settings(short_config):
    """A drive of which the noise is what it is taken for, but for what each seed draws."""
    drawn = {prior_name(name): sigma for name, sigma in DRAWN.items()}
    simulation = replace(
        short_config.data.simulation,
        frames=50,
        gyro_sigma=2e-4,
        velocity_sigma=2e-3,
        tracks_in_view=20,
        duplication_probability=0.0,
        drift_px=0.0,
        matching_bias_px=0.0,
        gyro_bias=(0.0, 0.0, 0.0),
        inertial_noise="step",
        **drawn,
    )
    root = np.sqrt(simulation.period)
    density = (simulation.gyro_sigma * root,) * 3 + (simulation.velocity_sigma * root,) * 3
    quiet = {"drift_px": 0.0, "matching_bias_px": 0.0, "twist_density": density, "bias_sigma": (1e-6,) * 6}
    noise = replace(short_config.noise, **quiet, bias_walk=(1e-7,) * 6)
    data = DataConfig(simulation=simulation, repair=RepairConfig(consensus=None))
    return replace(short_config, data=data, noise=noise)


def normalised(name, config, *, estimated, **options):
    """Squares of the normalised errors in the end: of the last pose (n, 6), and of each error (n, 10)."""
    poses, shared = [], []
    told = {**every_shared_error(), "clock_sigma": DRAWN["clock"]} if estimated else {}
    told = replace(config, noise=replace(config.noise, **told))
    for seed in SEEDS:
        dataset = open_dataset(config.data, seed=seed)
        estimator = find(name)(make_problem(told, dataset), options)
        found = run(estimator, dataset.sequence, pixel_sigma(told, dataset), name=name)
        assert found.complete, found.log.error
        error = se3.local(found.final.world_T_imu[-1], from_first(dataset.reference.pose)[-1])
        poses.append(error @ np.linalg.solve(found.final.covariances[-1], error))
        if estimated:
            _, truth = simulate(config.data.simulation, seed=seed, name="simulation")
            last = {key: (history.value[-1], history.sigma[-1]) for key, history in found.states.items()}
            shared.append(
                np.concatenate([((last[key][0] - truth.shared[key]) / last[key][1]) ** 2 for key in SIZES])
            )
    return np.array(poses), np.array(shared)


@pytest.mark.statistical
@pytest.mark.parametrize(
    ("name", "options"),
    [
        ("ekf_invariant", {"gate": False}),
        ("msckf", {"gate": False}),
        ("isam2", {"marginals": "poses", "pose_cov_every": 49}),
    ],
)
def test_estimated_they_are_as_far_off_as_is_said(name, options, short_config):
    poses, shared = normalised(name, settings(short_config), estimated=True, **options)
    n = len(SEEDS)
    low, high = chi2.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], 6 * n)
    assert low < poses.sum() < high, poses.sum() / (6 * n)
    each = FALSE_ALARM / shared.shape[1]
    low, high = chi2.ppf([each / 2, 1 - each / 2], n)
    assert ((low < shared.sum(axis=0)) & (shared.sum(axis=0) < high)).all(), shared.mean(axis=0)


@pytest.mark.statistical
def test_taken_for_known_they_are_not_in_what_is_said(short_config):
    """What the test above must see."""
    poses, _ = normalised("ekf_invariant", settings(short_config), estimated=False, gate=False)
    assert poses.sum() > 3.0 * chi2.ppf(1 - FALSE_ALARM, 6 * len(SEEDS))
