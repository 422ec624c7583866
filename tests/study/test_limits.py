"""What a study tells of lags and of the bound, from made-up trials."""

import numpy as np
import pytest

from vislam.study.page.figures import all_figures
from vislam.study.page.limits import against_bound, bound_table, keys_of_lags, lags_table, waiting
from vislam.study.page.verdict import verdict
from vislam.study.trials import Trials

LAGS = (0, 2, 10)


def made(*, excess: float = 1.0, keys=None) -> Trials:
    """Thirty trials of a filter whose error falls by half within 2 frames, and of a worse one."""
    rng = np.random.default_rng(3)
    records = []
    for seed in range(30):
        metrics = []
        for name, worse in (("good", 0.0), ("bad", 50.0)):
            luck = rng.normal(0.0, 0.5)
            values = {"bound_excess_position": excess + worse + luck, "bound_ratio_position": 1.0 + luck}
            metrics += [
                {"estimator": name, "key": key, "estimate": "filtered", "value": value}
                for key, value in (*values.items(), ("ate_rmse", 2.0))
            ]
            of_lags = {"0": 4.0, "2": 3.0, "10": 2.5, "all": 2.0}
            metrics += [
                {
                    "estimator": name,
                    "key": f"ate_rmse_lag_{lag}",
                    "estimate": None,
                    "value": value + 0.01 * luck,
                }
                for lag, value in of_lags.items()
            ]
            metrics.append({"estimator": name, "key": "frame_period_s", "estimate": None, "value": 0.1})
        runs = {name: {"complete": True, "error": ""} for name in ("good", "bad")}
        records.append(
            {"seed": seed, "point": {}, "status": "done", "reason": "", "runs": runs, "metrics": metrics}
        )
    return Trials.of_records(records, keys=keys)


def test_each_lag_has_a_row_with_its_mean_and_its_time():
    table = lags_table(made())
    assert [row[1:3] for row in table.rows[:4]] == [
        ["0", "0.00"],
        ["2", "0.20"],
        ["10", "1.00"],
        ["all", "all"],
    ]
    assert table.rows[1][3].startswith("3 (")


def test_half_of_the_gain_is_told_by_the_means():
    told = list(waiting(made()))
    assert told[0] == "good: half of what smoothing takes off the ATE (4 to 2 m) comes within 0.2 s."


def test_the_nearest_to_the_bound_is_told():
    told = " ".join(against_bound(made().of("filtered")))
    assert "position error of good is the nearest to the bound" in told
    assert "below" not in told
    assert len(bound_table(made().of("filtered")).rows) == 2


def test_who_is_below_the_bound_is_told():
    told = " ".join(against_bound(made(excess=-3.0).of("filtered")))
    assert "below the bound of the position, by more than chance: good." in told


def test_figures_and_verdict_have_both():
    trials = made(
        keys={
            *keys_of_lags(LAGS),
            "bound_excess_position",
            "bound_ratio_position",
            "ate_rmse",
            "nees_pose",
            "step_time_p50_ms",
            "ate_planar_rmse",
            "ate_rotation_rmse",
            "kitti_t_rel",
            "map_error_median",
            "held_out_median",
        }
    )
    assert {"lag_curve", "bound_filtered"} <= all_figures(trials).keys()
    assert any("comes within" in sentence for sentence in verdict(trials))


@pytest.mark.parametrize("keys", [None, {"ate_rmse"}])
def test_without_lags_or_bound_there_is_nothing(keys):
    runs = {"good": {"complete": True, "error": ""}}
    metric = {"estimator": "good", "key": "ate_rmse", "estimate": "filtered", "value": 1.0}
    record = {"seed": 0, "point": {}, "status": "done", "reason": "", "runs": runs, "metrics": [metric]}
    trials = Trials.of_records([record], keys=keys)
    assert not lags_table(trials).rows
    assert not bound_table(trials).rows
    assert not [*waiting(trials), *against_bound(trials)]
    assert keys_of_lags(()) == []
