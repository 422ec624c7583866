"""Two runs next to each other: their distance in what they claim, when they part, who claims more."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from tests.evaluation.test_evaluation import circle, made_run
from tests.records import altered
from vislam.core.trajectory import Poses
from vislam.evaluation.agreement import Agreement, agreement, compared, transported
from vislam.evaluation.normalised import COMPONENTS, usable
from vislam.geometry import se3

FRAMES = 400


def covariances(rng, count=FRAMES):
    """Covariances of poses, of some millimetres and milliradians."""
    factor = np.diag([2e-3] * 3 + [0.01] * 3) @ (np.eye(6) + 0.3 * rng.normal(size=(count, 6, 6)))
    return factor @ factor.transpose(0, 2, 1) + np.diag([1e-7] * 3 + [1e-6] * 3)


def drawn(rng, truth, cov):
    """Estimates whose errors on the right are drawn from covariances, exact at the start."""
    error = np.einsum("tij,tj->ti", np.linalg.cholesky(cov), rng.normal(size=(len(cov), 6)))
    error[0] = 0.0
    return truth @ se3.inverse(se3.exp(error))


def pair(rng):
    """Two consistent runs with independent errors."""
    truth = circle(frames=FRAMES)
    first, second = covariances(rng), covariances(rng)
    return (
        made_run("a", drawn(rng, truth, first), cov=first),
        made_run("b", drawn(rng, truth, second), cov=second),
    )


def test_independent_consistent_runs_are_one_apart_and_do_not_part(rng):
    found = agreement(*pair(rng))
    assert found.per_freedom == pytest.approx(1.0, abs=0.15)
    assert found.share_beyond() == pytest.approx(0.05, abs=0.04)
    assert found.divergence() is None
    assert np.array_equal(found.frame, np.arange(1, FRAMES))


def test_a_smoother_and_a_filter_with_the_same_error_in_part_are_closer(rng):
    """The filter's error is the smoother's and an independent one: its covariance is the sum of theirs."""
    truth = circle(frames=FRAMES)
    late, more = covariances(rng), covariances(rng)
    smoother = drawn(rng, truth, late)
    filtered = drawn(rng, smoother, more)
    found = agreement(
        made_run("filter", truth, filtered=Poses(filtered, late + more)),
        made_run("smoother", smoother, cov=late),
        estimates=("filtered", "filtered"),
    )
    assert 0.2 < found.per_freedom < 0.8
    assert found.share_beyond() < 0.02
    # The difference itself has the covariance P_a - P_b.
    exact = np.einsum("ti,tij,tj->t", found.difference, np.linalg.inv(more[1:]), found.difference)
    assert exact.mean() / 6.0 == pytest.approx(1.0, abs=0.15)
    assert found.certainty().overall > 1.0


def test_opposite_errors_are_two_apart_and_no_errors_are_more(rng):
    truth = circle(frames=FRAMES)
    cov = covariances(rng)
    error = np.einsum("tij,tj->ti", np.linalg.cholesky(cov), rng.normal(size=(FRAMES, 6)))
    error[0] = 0.0
    found = agreement(
        made_run("a", truth @ se3.exp(error), cov=cov),
        made_run("b", truth @ se3.exp(-error), cov=cov),
    )
    assert found.per_freedom == pytest.approx(2.0, abs=0.3)


def test_worlds_are_joined_at_the_first_pose(rng):
    one, other = pair(rng)
    moved = altered(other, world_T_imu=se3.exp(rng.normal(size=6)) @ other.final.world_T_imu)
    assert np.allclose(agreement(one, other).squared, agreement(one, moved).squared, rtol=1e-6)


def test_the_distance_is_symmetric_to_first_order(rng):
    one, other = pair(rng)
    there, back = agreement(one, other), agreement(other, one)
    assert np.allclose(there.difference, -back.difference)
    # The difference turns the axes by some hundredths of a radian.
    assert np.allclose(there.squared, back.squared, rtol=0.02)
    # The same covariances a hundred times as small: a difference ten times as small.
    small = [
        altered(
            run,
            world_T_imu=circle(FRAMES) @ se3.exp(0.1 * se3.local(circle(FRAMES), run.final.world_T_imu)),
            cov=0.01 * run.final.covariances,
        )
        for run in (one, other)
    ]
    there, back = agreement(*small), agreement(*small[::-1])
    assert np.allclose(there.squared, back.squared, rtol=0.002)


def test_a_covariance_is_taken_along_to_the_other_pose(rng):
    difference = np.array([[0.4, -0.3, 0.8, 1.0, 2.0, -0.5]])
    cov = 1e-8 * covariances(rng, count=1)
    start = se3.exp(difference)
    draws = rng.multivariate_normal(np.zeros(6), cov[0], 20000)
    found = np.cov(se3.log(start @ se3.exp(draws)).T)
    scale = np.sqrt(np.outer(np.diag(found), np.diag(found)))
    assert np.abs((transported(cov, difference)[0] - found) / scale).max() < 0.05
    assert np.abs((cov[0] - found) / scale).max() > 0.1


def test_the_distance_is_that_of_both_covariances_at_the_first_pose(rng):
    one, other = pair(rng)
    found = agreement(one, other)
    total = one.final.covariances[1:] + transported(other.final.covariances[1:], found.difference)
    expected = np.einsum(
        "ti,ti->t", found.difference, np.linalg.solve(total, found.difference[..., None])[..., 0]
    )
    assert np.allclose(found.squared, expected, rtol=1e-9)
    assert np.allclose(se3.retract(one.final.world_T_imu[1:], found.difference), other.final.world_T_imu[1:])


@pytest.mark.parametrize("frames", [50, 1000])
def test_the_bound_of_divergence_is_shared_out_over_the_frames(rng, frames):
    """Errors that stay, as those of a pose do, are beyond the bound of one frame in one drive of many."""
    alarm = 0.01
    made = Agreement(("filtered", "filtered"), *(np.arange(frames), *[np.empty(0)] * 4))
    level = chi2.isf(alarm / frames, 6)
    for share, expected in ((0.999, None), (1.001, 0)):
        assert replace(made, squared=np.full(frames, share * level)).divergence(alarm) == expected


def test_runs_part_where_one_goes_astray_for_good(rng):
    one, other = pair(rng)
    astray = other.final.world_T_imu.copy()
    astray[200:] = astray[200:] @ se3.exp(np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0]))
    assert agreement(one, altered(other, world_T_imu=astray)).divergence() == 200
    # One bad pose is no divergence.
    astray = other.final.world_T_imu.copy()
    astray[200] = astray[200] @ se3.exp(np.array([0.0, 0.0, 0.0, 0.5, 0.0, 0.0]))
    found = agreement(one, altered(other, world_T_imu=astray))
    assert found.squared[199] > 100.0
    assert found.divergence() is None


def test_a_planted_swap_of_the_tangent_order_is_seen(rng):
    one, other = pair(rng)
    order = [3, 4, 5, 0, 1, 2]
    swapped = [altered(run, cov=run.final.covariances[:, order][:, :, order]) for run in (one, other)]
    assert agreement(*swapped).divergence() is not None
    assert agreement(*swapped).per_freedom > 2.0


def test_ratios_are_those_of_the_variances_and_name_the_component(rng):
    truth = circle(frames=FRAMES)
    cov = np.tile(np.diag([1e-6, 2e-6, 3e-6, 1e-4, 2e-4, 3e-4]), (FRAMES, 1, 1))
    change = np.array([1.0, 1.0, 25.0, 1.0, 1.0, 0.04])
    one = made_run("a", truth, cov=cov * change)
    found = agreement(one, made_run("b", truth, cov=cov))
    assert np.allclose(found.ratios, [0.04, 1.0, 1.0, 1.0, 1.0, 25.0])
    said = found.certainty()
    assert (said.smallest_along, said.largest_along) == ("up", "yaw")
    assert said.smallest == pytest.approx(0.04)
    assert said.largest == pytest.approx(25.0)
    assert said.overall == pytest.approx(1.0)
    assert COMPONENTS[found.along[0, 0]] == "up"


def test_ratios_do_not_depend_on_the_coordinates(rng):
    first, second = covariances(rng, 30), covariances(rng, 30)
    change = rng.normal(size=(6, 6)) + 3.0 * np.eye(6)
    plain, along = compared(first, second)
    moved, _ = compared(change @ first @ change.T, change @ second @ change.T)
    assert np.allclose(plain, moved, rtol=1e-6)
    # Nor does the component on the units.
    units = np.diag(rng.uniform(0.01, 100.0, 6))
    scaled, same = compared(units @ first @ units, units @ second @ units)
    assert np.allclose(plain, scaled, rtol=1e-6)
    assert np.array_equal(along, same)


def test_frames_without_both_covariances_are_left_out(rng):
    one, other = pair(rng)
    cov = one.final.covariances.copy()
    cov[7] = np.nan
    found = agreement(altered(one, cov=cov), other)
    assert np.array_equal(found.frame, [*range(1, 7), *range(8, FRAMES)])
    bare = replace(other, filtered=Poses(other.filtered.world_T_imu), smoothed=other.filtered)
    assert agreement(one, bare, estimates=("filtered", "filtered")) is None
    assert agreement(made_run("none", circle(0)), other) is None


def test_runs_that_are_worlds_apart_are_compared_where_numbers_last(rng):
    """A filter that is degenerate by 200 km; nothing is left of the other's covariance over there."""
    sound, other = pair(rng)
    astray = other.final.world_T_imu.copy()
    astray[FRAMES // 2 :, 0, 3] += 2e5
    found = agreement(sound, altered(other, world_T_imu=astray))
    assert found is not None
    assert np.isfinite(found.ratios).all()
    assert (found.ratios > 0.0).all()
    assert set(range(1, FRAMES // 2)) <= set(found.frame.tolist())
    assert np.isfinite(found.certainty().overall)


def test_a_ratio_is_never_below_zero():
    """Rounding can leave a covariance with a variance of -1e-18 along some direction."""
    ratios, _ = compared(np.diag([1.0, -1e-18, 4.0])[None], np.eye(3)[None])
    assert (ratios > 0.0).all()
    assert ratios[0, 1:] == pytest.approx([1.0, 4.0])


def test_what_is_not_symmetric_is_no_covariance(rng):
    cov = covariances(rng, count=3)
    cov[1, 0, 4] += 0.1 * np.sqrt(cov[1, 0, 0] * cov[1, 4, 4])
    assert usable(cov).tolist() == [True, False, True]
