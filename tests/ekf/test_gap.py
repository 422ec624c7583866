"""Motion noise over gaps: a long step has that of as many short ones, for every estimator."""

from dataclasses import replace

import numpy as np
import pytest

from tests.smoother.drives import drive, thinned
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.core.estimator import find
from vislam.estimators.loop import run

PERIOD, LONG = 0.1, 7
NAMES = {
    "dead_reckoning": {},
    "ekf": {},
    "ekf_fej": {},
    "ekf_invariant": {},
    "eks": {},
    "msckf": {},
    "isam2": {"pose_cov_every": 1},
    "isam2_between": {"pose_cov_every": 1},
    "fixed_lag": {"pose_cov_every": 1},
}


@pytest.fixture(scope="module")
def standing():
    """A stationary body without any track; the bias is known."""
    config, dataset = drive(seed=1, frames=2 * LONG + 1, period=PERIOD, tracks_in_view=1)
    sequence = dataset.sequence.select(np.zeros(dataset.sequence.observations, bool))
    sequence = replace(sequence, twist=np.zeros_like(sequence.twist))
    noise = replace(config.noise, bias_sigma=(1e-9,) * 6, bias_walk=(1e-9,) * 6, first_pose_sigma=(1e-6,) * 6)
    return replace(config, noise=noise), replace(dataset, sequence=sequence)


@pytest.mark.parametrize(("name", "options"), NAMES.items())
def test_a_gap_widens_the_motion_noise_by_its_length(standing, name, options):
    config, dataset = standing
    # Short steps, and one long one from the eighth frame to the last.
    kept = np.r_[: LONG + 1, 2 * LONG]
    covs = []
    for sequence in (dataset.sequence, thinned(dataset.sequence, kept)):
        given = replace(dataset, sequence=sequence)
        found = run(
            find(name)(make_problem(config, given), options),
            sequence,
            pixel_sigma(config, given),
            name=name,
        )
        covs.append(found.filtered.cov)
    every, gap = covs
    wanted = np.array(config.noise.twist_density) ** 2 * PERIOD * np.arange(2 * LONG + 1)[:, None]
    turned = np.diagonal(every, axis1=1, axis2=2)[1:, :3]
    assert np.allclose(turned, wanted[1:, :3], rtol=1e-2)
    assert np.allclose(gap[-1, :3, :3], every[-1, :3, :3], rtol=1e-2, atol=1e-9)
    assert np.allclose(gap[-2], every[LONG], rtol=1e-2, atol=1e-9)
    step = np.diagonal(gap[-1] - gap[-2])
    assert np.all(step[:3] > 0.98 * LONG * np.diagonal(gap[1])[:3])
    assert np.all(step[3:] > 0.98 * LONG * np.diagonal(gap[1])[3:])
