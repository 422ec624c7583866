"""The table of trials: order of its points, failures and gaps."""

from dataclasses import replace

import numpy as np
import pytest

from tests.study.synthetic import lost, record
from vislam.study.page.labels import errors, metric_label
from vislam.study.page.tables import pairs_table
from vislam.study.page.verdict import verdict
from vislam.study.summary import header, rows_of
from vislam.study.trials import Trials


def test_points_come_in_order_with_all_their_trials():
    sweep = [(2.0, "b"), (10.0, "a"), (1.0, "b"), (2.0, "b"), (1.0, "a")]
    trials = Trials.of_records([record(0, {"sigma": x, "mode": mode}, {}) for x, mode in sweep])
    found = [((point["sigma"], point["mode"]), rows.tolist()) for point, rows in trials.groups()]
    # Numbers ascend; words stay as they came; points that nobody ran are left out.
    assert found == [((1.0, "b"), [2]), ((1.0, "a"), [4]), ((2.0, "b"), [0, 3]), ((10.0, "a"), [1])]


def test_without_a_sweep_all_trials_are_one_point():
    trials = Trials.of_records([record(seed, {}, {"ekf": {}}) for seed in range(4)])
    ((point, rows),) = trials.groups()
    assert point == {}
    assert rows.tolist() == [0, 1, 2, 3]
    assert Trials.of_records([]).groups() == []


def test_lists_of_a_parameter_are_values_like_others():
    trials = Trials.of_records([record(0, {"bias": [0.0, x]}, {}) for x in (1.0, 0.0, 1.0)])
    assert [(point["bias"], len(rows)) for point, rows in trials.groups()] == [
        ((0.0, 1.0), 2),
        ((0.0, 0.0), 1),
    ]


def test_what_a_broken_run_scored_does_not_count():
    trials = Trials.of_records(
        [
            record(0, {}, {"ekf": {"ate_rmse": 1.0}, "isam2": {"ate_rmse": 2.0}}),
            record(1, {}, {"ekf": {"ate_rmse": 0.1}, "isam2": {"ate_rmse": None}}, failed=("ekf",)),
            lost(2, {}),
        ]
    )
    np.testing.assert_array_equal(trials.value("ekf", "ate_rmse"), [1.0, np.nan, np.nan])
    np.testing.assert_array_equal(trials.value("isam2", "ate_rmse"), [2.0, np.nan, np.nan])
    assert np.isnan(trials.value("isam2", "unknown")).all()
    assert trials.reason == ("", "ekf: diverged", "worker was killed")
    assert trials.done.tolist() == [True, True, False]


def test_trials_that_sweep_different_parameters_are_refused():
    with pytest.raises(ValueError, match=r"\['sigma'\], got \['frames'\]"):
        Trials.of_records([record(0, {"sigma": 1.0}, {}), record(1, {"frames": 30}, {})])


def both(seed, filtered, smoothed):
    """A trial of a filter, and of a smoother with the errors of its two estimates."""
    found = record(seed, {}, {"ekf": {}, "isam2": {"step_time_p50_ms": 7.0}})
    entries = [("ekf", "filtered", 1.0), ("isam2", "filtered", filtered), ("isam2", "smoothed", smoothed)]
    found["metrics"] += [
        {"estimator": name, "key": "ate_rmse", "estimate": estimate, "value": value}
        for name, estimate, value in entries
    ]
    return found


def test_an_estimate_has_the_runs_that_have_it_and_no_other():
    trials = Trials.of_records([both(seed, 3.0, 0.5) for seed in range(8)])
    assert trials.estimates == ("filtered", "smoothed")
    filtered, smoothed = (trials.of(estimate) for estimate in trials.estimates)
    assert (list(filtered.complete), list(smoothed.complete)) == (["ekf", "isam2"], ["isam2"])
    np.testing.assert_array_equal(filtered.value("isam2", "ate_rmse"), np.full(8, 3.0))
    np.testing.assert_array_equal(smoothed.value("isam2", "ate_rmse"), np.full(8, 0.5))
    # What is of the run as a whole is of both; without a word it is the final estimate.
    assert filtered.value("isam2", "step_time_p50_ms")[0] == smoothed.value("isam2", "step_time_p50_ms")[0]
    assert trials.value("isam2", "ate_rmse")[0] == 0.5
    assert trials.value("ekf", "ate_rmse")[0] == 1.0


def test_a_smoothed_estimate_is_not_held_against_a_filtered_one():
    trials = Trials.of_records([both(seed, 3.0 + 0.1 * seed, 0.5) for seed in range(8)])
    filtered, smoothed = (pairs_table(trials.of(estimate)) for estimate in trials.estimates)
    (row,) = filtered.rows
    assert row[0] == "ekf less isam2"
    assert row[-2].startswith("100 %")
    assert smoothed.rows == []
    told = verdict(trials)
    assert "Filtered: median ATE over all trials that finished: ekf 1 m (1 to 1), isam2" in " ".join(told)
    (alone,) = [text for text in told if text.startswith("Smoothed: ")]
    assert "isam2 0.5 m" in alone
    assert "ekf" not in alone


def test_upright_trials_are_compared_after_an_alignment_of_heading_and_position():
    errors_m = {"ate_rmse": 1.0, "ate_yaw_position_rmse": 2.0, "nees_pose": 1.0}
    trials = Trials.of_records([record(seed, {}, {"ekf": errors_m}) for seed in range(2)])
    upright = replace(trials, upright=True)
    for found, keys, told in (
        (trials, ["ate_rmse"], "1.000"),
        (upright, ["ate_yaw_position_rmse", "ate_rmse"], "2.000"),
    ):
        assert errors(found) == keys
        assert metric_label(keys[0]) == header(found)[4]
        assert rows_of(found)[0][4] == told
