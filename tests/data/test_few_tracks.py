"""Few tracks a frame: what all together tell of the twist, and the twist as a voter on each of them."""

from dataclasses import replace

import numpy as np
import pytest

from vislam.core.inertial_vote import few_track_distances
from vislam.core.pooled_fit import inertial_pairs, twist_error
from vislam.core.rigid_fit import FEWEST, continuations
from vislam.repair.consensus import Consensus
from vislam.simulation import SimulationConfig, simulate

BIAS = (0.006, -0.008, 0.004)


@pytest.fixture(scope="module")
def sparse():
    """Some three tracks a frame that live for five, none of them wrong."""
    config = SimulationConfig(
        frames=300, tracks_in_view=3, loss_probability=0.2, gyro_bias=BIAS, pixel_sigma_px=0.3
    )
    sequence = simulate(config, seed=3, name="sparse")[0]
    return sequence.select(sequence.disparity > 1.0)


def test_no_step_of_it_shows_its_motion_alone(sparse):
    assert np.diff(continuations(sparse).start).max() < FEWEST + 2
    assert np.median(np.diff(continuations(sparse).start)) < 4


def test_all_pairs_together_tell_the_bias(sparse):
    error = twist_error(inertial_pairs(sparse))
    sigma = np.sqrt(np.diagonal(error.cov))
    assert (sigma[:3] < 0.002).all()
    assert (np.abs(error.mean - [*BIAS, *np.zeros(6)]) < 4.0 * sigma).all()


def test_the_derivative_is_that_of_the_prediction(sparse):
    found, step = inertial_pairs(sparse), 1e-6
    for axis in range(6):
        twist = sparse.twist.copy()
        twist[:, axis] -= step
        other = inertial_pairs(replace(sparse, twist=twist))
        slope = (found.residual - other.residual) / step
        scale = np.abs(found.by_error[:, :, axis]).max()
        assert np.allclose(slope, found.by_error[:, :, axis], atol=1e-4 * scale)


def test_a_slip_is_cut_where_two_others_go_on(sparse):
    pairs = continuations(sparse)
    many = np.diff(pairs.start)
    k = int(np.flatnonzero(many == 3)[10])
    row = int(pairs.after[pairs.start[k] + 1])
    pixels = sparse.pixels.copy()
    pixels[row] += [9.0, -4.0, 7.0, -4.0]
    distance = few_track_distances(replace(sparse, pixels=pixels))
    before = few_track_distances(sparse)
    assert before[row] < 5.0 < distance[row]
    # Those beside it are not blamed for it.
    beside = np.setdiff1d(pairs.after[pairs.start[k] : pairs.start[k + 1]], row)
    assert (distance[beside] < np.maximum(5.0, 1.2 * before[beside])).all()


def test_good_tracks_are_left_alone(sparse):
    distance = few_track_distances(sparse)
    known = distance[np.isfinite(distance)]
    assert len(known) > 300
    assert np.isclose(np.median(known), 1.538, rtol=0.05)
    assert np.mean(known > 5.0) < 0.08


def test_a_twist_that_does_not_fit_has_no_vote(sparse):
    wrong = replace(sparse, twist=-sparse.twist)
    assert twist_error(inertial_pairs(wrong)) is None
    cut = Consensus().apply(wrong)
    assert cut.counts["inconsistent_cuts_few_tracks"] == 0
