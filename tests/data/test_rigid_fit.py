"""Rigid fits of many frames at a time, against the fit of each frame by itself."""

from dataclasses import fields

import numpy as np
import pytest

from vislam.core import rigid_fit
from vislam.core.rigid_fit import FEWEST, continuations, fit_rigid, predicted_steps, rigid_fits, step_spread
from vislam.simulation import SimulationConfig, simulate


@pytest.fixture(scope="module")
def sequence():
    """Frames of very different numbers of tracks, some of them with too few to vote, with outliers."""
    drive, _ = simulate(
        SimulationConfig(frames=40, tracks_in_view=14.0, outlier_probability=0.1), seed=5, name="few"
    )
    return drive.select(np.random.default_rng(6).random(drive.observations) < 0.7)


@pytest.mark.parametrize("block", [1, 64, 8192])
def test_frames_together_are_fitted_as_each_by_itself(sequence, monkeypatch, block):
    monkeypatch.setattr(rigid_fit, "_BLOCK", block)
    pairs = continuations(sequence)
    count = np.diff(pairs.start)
    fits = rigid_fits(sequence, pairs)
    assert list(fits) == np.flatnonzero(count >= FEWEST).tolist()
    assert 10 < len(fits) < len(sequence)
    points, guess = sequence.rig.back_project(sequence.z), predicted_steps(sequence)
    spread = step_spread(sequence.disparity)
    for k, fit in fits.items():
        old, new = (part[pairs.start[k] : pairs.start[k + 1]] for part in (pairs.before, pairs.after))
        alone = fit_rigid(sequence.rig, points[old], sequence.z[new], spread=spread[old], guess=guess[k])
        for part in fields(fit):
            # Sums in another order; the covariance of a few tracks has a condition of some 1e6.
            one, other = getattr(fit, part.name), getattr(alone, part.name)
            np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9 * np.abs(other).max())


def test_without_pairs_there_are_no_fits(sequence):
    empty = sequence.select(np.zeros(sequence.observations, bool))
    assert rigid_fits(empty, continuations(empty)) == {}
