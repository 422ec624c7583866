"""The table of trials: order of its points, failures and gaps."""

import numpy as np
import pytest

from tests.study.synthetic import lost, record
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
