"""Maps against the true one and against each other."""

import numpy as np
import pytest

from tests.evaluation.test_evaluation import circle, made_run
from tests.records import altered
from vislam.core.reference import truth_reference
from vislam.evaluation.maps import binned, map_difference, map_errors
from vislam.geometry import se3

POINTS = 1000
MOVE = se3.exp(np.array([0.3, -0.2, 1.1, 5.0, -7.0, 2.0]))
TURN = MOVE[:3, :3]


def claims(rng):
    """Covariances of landmarks, far less certain in one direction than in the others [m^2]."""
    factor = np.diag([1.0, 0.1, 0.1]) @ (np.eye(3) + 0.1 * rng.normal(size=(POINTS, 3, 3)))
    return factor @ factor.transpose(0, 2, 1)


def drawn(rng, cov):
    return np.einsum("tij,tj->ti", np.linalg.cholesky(cov), rng.normal(size=(len(cov), 3)))


@pytest.fixture
def world(rng):
    """True landmarks, and a run in a world of its own that claims what its errors are drawn from."""
    true = 40.0 * rng.normal(size=(POINTS, 3))
    cov = claims(rng)
    mine = se3.transform(se3.inverse(MOVE), true) + drawn(rng, cov)
    track = np.arange(POINTS)
    run = made_run("one", circle(10), track=track, points_world=mine, points_cov=cov)
    return run, truth_reference(circle(10), track, true)


def errors(run, reference, depth=1.0):
    return map_errors(run, reference, alignment=MOVE, depth=np.full(len(reference.track), depth))


def test_landmarks_drawn_from_the_claim_are_consistent_with_it(world):
    found = errors(*world).normalised
    assert found.name == "nees_landmark"
    assert found.statistic().p_value() > 1e-3
    assert np.allclose(found.within().T, [0.683, 0.954, 0.997], atol=0.05)
    curve = found.coverage_curve()
    assert np.abs(curve - np.linspace(0.0, 1.0, 41)).max() < 0.06


FAULTS = {
    "half the noise": lambda cov: 0.25 * cov,
    "twice the noise": lambda cov: 4.0 * cov,
    "axes of the other world": lambda cov: TURN @ cov @ TURN.T,
    "axes swapped": lambda cov: cov[:, ::-1, ::-1],
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_planted_fault_in_the_claim_is_found(world, fault):
    run, reference = world
    wrong = altered(run, points_cov=FAULTS[fault](run.landmarks.points_cov))
    assert errors(wrong, reference).normalised.statistic().p_value() < 1e-3


def test_the_share_found_counts_what_is_near_for_its_depth(rng):
    true = rng.normal(size=(100, 3))
    off = np.zeros((100, 3))
    off[:, 0] = np.repeat([0.4, 0.6, 3.0, 6.0], 25)
    # Of a hundred true landmarks the last ten have not been estimated, and one is of nobody's.
    run = made_run("one", circle(10), track=np.arange(91) * 2, points_world=(true + off)[:91])
    run = altered(run, track=np.where(run.landmarks.track == 180, 181, run.landmarks.track))
    reference = truth_reference(circle(10), np.arange(100) * 2, true)
    near = map_errors(run, reference, alignment=np.eye(4), depth=np.full(100, 10.0))
    assert len(near.track) == 90
    assert np.allclose(near.distance, off[:90, 0])
    assert near.estimated == 0.9
    assert near.found == 0.25
    assert map_errors(run, reference, alignment=np.eye(4), depth=np.full(100, 80.0)).found == 0.75
    assert near.normalised is None


def test_maps_without_anything_in_common_are_not_compared(world):
    run, reference = world
    other = altered(run, track=run.landmarks.track + POINTS)
    assert errors(other, reference) is None
    assert map_difference(run, other) is None


def test_landmarks_without_a_claim_are_left_out_of_it(world):
    run, reference = world
    cov = run.landmarks.points_cov.copy()
    cov[3], cov[4] = np.nan, 0.0
    found = errors(altered(run, points_cov=cov), reference)
    assert len(found.distance) == POINTS
    assert np.array_equal(found.normalised.index, np.delete(np.arange(POINTS), [3, 4]))
    assert errors(altered(run, points_cov=np.full_like(cov, np.nan)), reference).normalised is None


@pytest.fixture
def two(rng, world):
    """Two runs whose landmarks have independent errors, in worlds of their own."""
    run, reference = world
    cov = claims(rng)
    other = made_run(
        "other",
        MOVE @ circle(10),
        track=run.landmarks.track[::-1],
        points_world=(reference.points_world + drawn(rng, cov) @ TURN.T)[::-1],
        points_cov=(TURN @ cov @ TURN.T)[::-1],
    )
    return run, other


def test_independent_maps_are_apart_by_both_their_errors(two):
    there, back = map_difference(*two), map_difference(*two[::-1])
    assert there.squared.mean() == pytest.approx(3.0, abs=0.3)
    assert np.allclose(there.squared, back.squared)
    assert np.allclose(there.distance, back.distance)
    wrong = [altered(run, points_cov=run.landmarks.points_cov[:, ::-1, ::-1]) for run in two]
    assert map_difference(*wrong).squared.mean() > 4.0


def test_distances_stand_without_covariances(two):
    bare = map_difference(two[0], altered(two[1], points_cov=None))
    assert np.allclose(bare.distance, map_difference(*two).distance)
    assert np.isnan(bare.squared).all()


def test_bins_count_each_landmark_once_and_have_its_medians(two):
    found = map_difference(*two)
    by = np.arange(POINTS) % 10
    table = binned(found.distance, found.squared, by=by, edges=np.array([0.0, 2.0, 5.0, 9.0, 20.0, 30.0]))
    assert [one.count for one in table] == [200, 300, 400, 100, 0]
    assert [(one.low, one.high) for one in table][1] == (2.0, 5.0)
    second = (by >= 2) & (by < 5)
    assert table[1].distance == np.median(found.distance[second])
    assert table[1].mahalanobis == np.median(np.sqrt(found.squared[second]))
    assert all(one.beyond == pytest.approx(0.05, abs=0.08) for one in table[:4])
    assert np.isnan([table[4].distance, table[4].mahalanobis, table[4].beyond]).all()
    bold = binned(found.distance, 9.0 * found.squared, by=by, edges=np.array([0.0, 10.0]))
    assert bold[0].beyond > 0.5


def test_a_bin_without_covariances_has_a_distance(two):
    found = map_difference(two[0], altered(two[1], points_cov=None))
    table = binned(found.distance, found.squared, by=np.zeros(POINTS), edges=np.array([0.0, 1.0]))
    assert table[0].distance == np.median(found.distance)
    assert np.isnan(table[0].mahalanobis)
