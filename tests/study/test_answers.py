"""Answers of a study, against trials whose errors, claims and failures are known."""

import numpy as np
import pytest
from scipy.stats import norm

from tests.study.synthetic import lost, record, study
from vislam.study import answers
from vislam.study.trials import Trials


def of_errors(one, other):
    """Trials of two estimators with these errors."""
    pairs = enumerate(zip(one, other, strict=True))
    return Trials.of_records(
        [record(seed, {}, {"a": {"ate_rmse": a}, "b": {"ate_rmse": b}}) for seed, (a, b) in pairs]
    )


def rows(trials):
    return np.arange(len(trials))


def test_a_failure_rate_counts_runs_and_leaves_out_trials_nobody_ran():
    records = [record(seed, {}, {"ekf": {}}, failed=("ekf",) if seed < 3 else ()) for seed in range(20)]
    trials = Trials.of_records([*records, lost(20, {}), lost(21, {})])
    found = answers.failure_rate(trials, "ekf", rows=rows(trials))
    assert (found.value, found.count, found.missing) == (0.15, 20, 2)
    assert found.low < 0.15 < found.high
    assert answers.failure_rate(trials, "ekf", rows=np.array([20, 21])) is None


def test_a_consistent_estimator_is_taken_for_one_and_an_overconfident_one_is_not(rng):
    held = 0
    for _ in range(40):
        trials = Trials.of_records(study({}, seeds=30, overconfident=lambda _: 2.5, rng=rng))
        wrong = answers.pooled_nees(trials, "ekf", rows=rows(trials))
        right = answers.pooled_nees(trials, "isam2", rows=rows(trials))
        held += right.mean.low < 1.0 < right.mean.high
        assert wrong.mean.low > 1.5
        assert wrong.beyond.low > 0.05
        assert right.beyond.value <= 0.05
    # 38 of 40 are expected; fewer than 33 come once in a thousand times.
    assert held >= 33


def test_one_rule_accuses_whatever_the_spread():
    """A mean of 48.8 from one bad trial is accused as one of 8.8 from many alike."""
    alike, one_bad = [8.7, 8.8, 8.9] * 3, [0.5] * 8 + [435.2]
    records = [
        record(seed, {}, {"alike": {"nees_pose": a}, "one_bad": {"nees_pose": b}})
        for seed, (a, b) in enumerate(zip(alike, one_bad, strict=True))
    ]
    trials = Trials.of_records(records)
    first, second = (answers.pooled_nees(trials, name, rows=rows(trials)) for name in ("alike", "one_bad"))
    assert (first.mean.value, second.mean.value) == pytest.approx((8.8, 48.8), abs=0.01)
    assert first.bounds == second.bounds
    assert first.overconfident
    assert second.overconfident


def test_the_rule_accuses_consistent_trials_of_one_constant_error_as_often_as_it_says(rng):
    """The least favourable case: each trial is one pose. 2.5 % on either side of 2000 studies."""
    means = rng.chisquare(6, (2000, 7)).mean(axis=1) / 6
    trials = Trials.of_records([record(seed, {}, {"ekf": {"nees_pose": 1.0}}) for seed in range(7)])
    low, high = answers.pooled_nees(trials, "ekf", rows=rows(trials)).bounds
    assert np.mean(means > high) == pytest.approx(0.025, abs=0.012)
    assert np.mean(means < low) == pytest.approx(0.025, abs=0.012)


def test_a_trial_whose_error_never_changes_is_beyond_the_bound_once_in_twenty(rng):
    nees = np.sum(rng.normal(size=(4000, 6)) ** 2, axis=1) / 6
    records = [record(seed, {}, {"ekf": {"nees_pose": value}}) for seed, value in enumerate(nees)]
    trials = Trials.of_records(records)
    found = answers.pooled_nees(trials, "ekf", rows=rows(trials))
    assert found.beyond.low < 0.05 < found.beyond.high
    assert answers.trial_bound() == pytest.approx(12.592 / 6, abs=1e-4)


def test_coverage_is_pooled_over_trials():
    trials = Trials.of_records(study({}))
    found = answers.pooled_coverage(trials, "ekf", rows=rows(trials))
    assert found.value == pytest.approx(trials.value("ekf", answers.COVERAGE).mean())
    assert 0.995 <= found.low < found.value < found.high <= 1.0
    assert pytest.approx(1.0 - 2.0 * norm.sf(3.0), abs=1e-4) == answers.CLAIMED


def test_a_paired_comparison_sees_a_shift_that_is_small_beside_the_spread_of_the_trials(rng):
    drive = rng.gamma(2.0, 1.0, 20)
    trials = of_errors(drive + rng.normal(0.1, 0.05, 20), drive)
    found = answers.paired(trials, "a", "b", "ate_rmse", rows=rows(trials))
    assert found.difference.low < 0.1 < found.difference.high
    assert found.difference.low > 0.0
    assert found.p_value < 1e-3
    assert found.better.high < 0.5
    turned = answers.paired(trials, "b", "a", "ate_rmse", rows=rows(trials))
    assert turned.difference.value == pytest.approx(-found.difference.value)
    assert turned.p_value == pytest.approx(found.p_value)


def test_a_paired_comparison_is_silent_without_a_shift(rng):
    accused = 0
    for _ in range(100):
        drive = rng.gamma(2.0, 1.0, 20)
        trials = of_errors(drive + rng.normal(0.0, 0.05, 20), drive + rng.normal(0.0, 0.05, 20))
        found = answers.paired(trials, "a", "b", "ate_rmse", rows=rows(trials))
        accused += found.p_value < 0.05
    # 5 of 100 are expected; more than 13 come once in two thousand times.
    assert accused <= 13


def test_equal_errors_are_no_difference():
    trials = of_errors([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    found = answers.paired(trials, "a", "b", "ate_rmse", rows=rows(trials))
    assert (found.difference.value, found.better.value, found.p_value) == (0.0, 0.5, 1.0)


def test_only_trials_that_both_finished_are_compared():
    trials = of_errors([1.0, np.nan, 2.0, 4.0], [2.0, 1.0, None, 6.0])
    found = answers.paired(trials, "a", "b", "ate_rmse", rows=rows(trials))
    assert found.difference.value == pytest.approx(-1.5)
    assert (found.difference.count, found.difference.missing) == (2, 2)
    assert answers.paired(trials, "a", "b", "ate_rmse", rows=np.array([1, 2])) is None


def nees_of(expected):
    """Consistency at points whose trials average these, None for a point where none finished."""
    found = []
    for value in expected:
        spread = [] if value is None else [value - 0.1, value, value + 0.1]
        records = [record(i, {}, {"ekf": {"nees_pose": one}}) for i, one in enumerate(spread)]
        records += [record(9, {}, {"ekf": {}}, failed=("ekf",))]
        trials = Trials.of_records(records)
        found.append(answers.pooled_nees(trials, "ekf", rows=rows(trials)))
    return found


@pytest.mark.parametrize(
    ("expected", "place"),
    [
        ([0.9, 1.1, 2.0, 3.0], 2),
        ([2.0, 1.0, 2.0, 3.0], 2),
        ([2.0, 2.0], 0),
        ([2.0, 1.0], None),
        ([0.5, 1.0], None),
        ([1.0, 2.0, None], 1),
        ([None, None], None),
    ],
)
def test_overconfidence_sets_in_where_it_begins_to_stay(expected, place):
    assert answers.onset(nees_of(expected)) == place


def test_means_and_medians_are_of_the_rows_that_are_asked_for():
    trials = of_errors([1.0, 2.0, 6.0, 100.0], [0.0] * 4)
    some = np.arange(3)
    assert answers.mean(trials, "a", "ate_rmse", rows=some).value == pytest.approx(3.0)
    assert answers.median(trials, "a", "ate_rmse", rows=some).value == 2.0


def ranked(*runs):
    """Trials of one estimator, one a run: seed, held-out error and ATE."""
    keys = ("held_out_median", "ate_rmse")
    return Trials.of_records(
        [
            record(seed, {"x": place}, {"ekf": dict(zip(keys, values, strict=True))})
            for place, (seed, *values) in enumerate(runs)
        ]
    )


def test_ranks_are_compared_among_the_runs_of_a_seed_alone():
    # The drive of the second seed is harder by far, and its runs stand in the other order.
    same = [(0, 1.0, 10.0), (0, 2.0, 11.0), (0, 4.0, 30.0)]
    turned = [(1, 100.0, 3.0), (1, 200.0, 2.0), (1, 300.0, 1.0)]
    found = answers.rank_correlation(ranked(*same), "held_out_median", "ate_rmse")
    assert (found.value, found.count) == (1.0, 1)
    both = answers.rank_correlation(ranked(*same, *turned), "held_out_median", "ate_rmse")
    assert (both.value, both.count) == (0.0, 2)
    half = answers.rank_correlation(
        ranked(*[(0, value, rank) for value, rank in zip((1, 2, 3, 4), (1, 2, 4, 3), strict=True)]),
        "held_out_median",
        "ate_rmse",
    )
    # 1 - 6 sum d^2 / (n (n^2 - 1)).
    assert half.value == pytest.approx(1.0 - 6.0 * 2.0 / 60.0)


@pytest.mark.parametrize(
    "runs",
    [
        [(0, 1.0, 1.0), (0, 2.0, 2.0)],
        [(0, 1.0, 1.0), (0, 1.0, 2.0), (0, 1.0, 3.0)],
        [(0, 1.0, 1.0), (0, 2.0, 2.0), (0, 3.0, None)],
    ],
    ids=["two runs", "one score", "a gap"],
)
def test_an_order_that_says_nothing_is_none(runs):
    assert answers.rank_correlation(ranked(*runs), "held_out_median", "ate_rmse") is None
