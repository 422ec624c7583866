"""Filtered poses against smoothed ones, by the difference of their covariances."""

from dataclasses import replace

import numpy as np
import pytest

from tests.evaluation.test_agreement import covariances, drawn
from tests.evaluation.test_evaluation import circle, made_run, of_truth
from tests.records import made_record
from vislam.api import run
from vislam.core.trajectory import Poses
from vislam.evaluation import evaluate
from vislam.evaluation.agreement import agreement
from vislam.evaluation.smoothing import TOLERANCE, smoothing_difference
from vislam.geometry import se3

FRAMES = 400


def smoother(rng, *, claimed=1.0):
    """A run whose filtered error is its smoothed one and an independent one; covariances ``claimed`` times
    theirs."""
    truth = circle(FRAMES)
    late, more = covariances(rng), covariances(rng)
    smoothed = drawn(rng, truth, late)
    filtered = Poses(drawn(rng, smoothed, more), claimed * (late + more))
    return made_run("smoother", smoothed, filtered=filtered, cov=claimed * late)


def test_the_right_sigmas_hold_and_ones_eight_times_too_small_do_not(rng):
    right, small = smoother(rng), smoother(rng, claimed=1.0 / 64.0)
    sound, wrong = (smoothing_difference(one, one).statistic() for one in (right, small))
    low, high = sound.interval()
    assert low < sound.value < high
    assert sound.value == pytest.approx(1.0, abs=0.1)
    assert sound.freedom == pytest.approx(6.0, abs=0.1)
    assert wrong.p_value() < 1e-6
    assert wrong.value == pytest.approx(64.0, rel=0.1)


def test_the_sum_lets_pass_what_the_difference_does_not(rng):
    """A filter that smoothing hardly moves: by the sum of the covariances, eight times too small a sigma is
    sound."""
    truth, late = circle(FRAMES), covariances(rng)
    more = 0.03 * late
    smoothed = drawn(rng, truth, late)
    filtered = Poses(drawn(rng, smoothed, 64.0 * more), late + more)
    one = made_run("one", smoothed, filtered=filtered, cov=late)
    by_sum = agreement(one, one, estimates=("filtered", "smoothed"))
    assert by_sum.share_beyond() < 0.05
    assert by_sum.per_freedom < 1.0
    assert smoothing_difference(one, one).statistic().value > 30.0


def test_a_filter_that_claims_more_than_the_smoother_is_counted_not_tested(rng):
    one = smoother(rng)
    less = one.filtered.covariances.copy()
    less[100:150] = 0.5 * one.smoothed.covariances[100:150]
    found = smoothing_difference(replace(one, filtered=Poses(one.filtered.world_T_imu, less)), one)
    assert found.indefinite == 50
    assert len(found.frame) == FRAMES - 51
    assert not np.isin(np.arange(100, 150), found.frame).any()


def test_directions_that_smoothing_does_not_help_are_not_tested(rng):
    one = smoother(rng)
    gain = np.diag([1.0, 1.0, 0.5 * TOLERANCE, 1.0, 1.0, 0.0])
    late = np.broadcast_to(np.eye(6) * 1e-4, (FRAMES, 6, 6))
    before = Poses(one.filtered.world_T_imu, late * (np.eye(6) + gain))
    after = Poses(one.filtered.world_T_imu, late)
    found = smoothing_difference(replace(one, filtered=before, smoothed=after), replace(one, smoothed=after))
    assert set(found.freedom.tolist()) == {4}
    same = smoothing_difference(replace(one, filtered=after, smoothed=after), replace(one, smoothed=after))
    assert (len(same.frame), same.untested, same.indefinite) == (0, FRAMES - 1, 0)
    assert same.statistic() is None


def test_worlds_are_joined_at_the_first_filtered_pose(rng):
    one = smoother(rng)
    moved = se3.exp(rng.normal(size=6))
    other = replace(one, filtered=one.filtered.moved(moved), smoothed=one.smoothed.moved(moved))
    here, there = (smoothing_difference(one, two).statistic() for two in (one, other))
    assert here.value == pytest.approx(there.value, rel=1e-6)


def test_pairs_are_tested_on_equal_information_only(rng):
    one = replace(smoother(rng), information={"kernel": "none"})
    filtered = replace(one, name="filter", smoothed=None)
    drive = made_record(of_truth(circle(FRAMES)))
    found = evaluate({"filter": filtered, "smoother": one}, drive)
    assert found.value("filter|smoother", "smoothing_per_dof") == found.value("smoother", "smoothing_per_dof")
    assert found.value("filter|smoother", "smoothing_by_sum") < 1.0
    assert found.value("smoother", "smoothing_indefinite") == 0.0
    assert found.statistic("filter|smoother", "smoothing").p_value() > 0.01
    # Whichever comes first, the one without smoothed poses is the filter.
    turned = evaluate({"smoother": one, "filter": filtered}, drive)
    assert turned.value("smoother|filter", "smoothing_per_dof") == pytest.approx(
        found.value("smoother", "smoothing_per_dof")
    )
    other = replace(filtered, information={"kernel": "student"})
    unequal = evaluate({"filter": other, "smoother": one}, drive)
    assert unequal.value("filter|smoother", "smoothing_per_dof") is None
    assert unequal.value("smoother", "smoothing_per_dof") is not None


@pytest.mark.slow
def test_of_simulated_filters_the_consistent_one_holds_and_the_standard_one_does_not():
    """On the drive of ci.yaml: the standard EKF is more certain than the smoother that had all its data and
    more."""
    runs = {name: run(name, "ci", options={"gate": False}) for name in ("ekf", "eks")}
    sound = smoothing_difference(runs["eks"], runs["eks"])
    low, high = sound.statistic().interval()
    assert low < sound.statistic().value < high
    assert sound.indefinite == 0
    standard = smoothing_difference(runs["ekf"], runs["eks"])
    assert standard.indefinite > 200
    assert standard.statistic().value > 1.0
    small = runs["eks"]
    small = replace(
        small,
        filtered=Poses(small.filtered.world_T_imu, small.filtered.covariances / 64.0),
        smoothed=Poses(small.smoothed.world_T_imu, small.smoothed.covariances / 64.0),
    )
    assert smoothing_difference(small, small).statistic().p_value() < 1e-6
