"""Checks on several drives together."""

import numpy as np
import pytest

from vislam.base.settings import parse
from vislam.comparison.config import Config
from vislam.evaluation.statistics import Statistic
from vislam.study.pooled import judge_pooled, pool


def statistic(value, *, effective=4.0, freedom=6.0):
    return Statistic("nees_pose", value, freedom, 100, effective, "of poses")


def result(value, *, ate=1.0, complete=True):
    plain = {key: getattr(statistic(value), key) for key in Statistic.__dataclass_fields__}
    return {
        "reason": "" if complete else "one: lost",
        "runs": {"one": {"complete": complete, "error": ""}},
        "metrics": [{"estimator": "one", "key": "ate_rmse", "estimate": "filtered", "value": ate}],
        "statistics": [{**plain, "estimator": "one", "estimate": "filtered"}],
    }


def config(*checks):
    tree = {"name": "a", "data": {"simulation": {}}, "estimators": {"one": {"estimator": "ekf"}}}
    return parse(Config, {**tree, "checks": [{"estimator": "one", **check} for check in checks]})


def test_a_pooled_statistic_varies_as_the_mean_of_independent_ones(rng):
    effective = np.array([2.0, 5.0, 9.0])
    draws = np.mean([rng.chisquare(6.0 * e, 20000) / (6.0 * e) for e in effective], axis=0)
    found = pool([statistic(1.0, effective=e) for e in effective])
    assert 2.0 / (found.freedom * found.effective) == pytest.approx(draws.var(), rel=0.05)
    assert found.samples == 300
    assert pool([statistic(1.3)]).interval() == statistic(1.3).interval()


def test_what_one_drive_cannot_tell_several_can():
    test = config({"test": "nees_pose"})
    assert judge_pooled(test, [result(1.6)])[0].holds
    (verdict,) = judge_pooled(test, [result(1.6)] * 8)
    assert not verdict.holds
    assert "1.6, expected " in verdict.measured
    assert verdict.estimate == "filtered"


def test_a_bound_is_on_the_mean_and_a_run_that_broke_off_holds_nothing():
    bound = config({"metric": "ate_rmse", "at_most": 2.0})
    assert judge_pooled(bound, [result(1.0, ate=1.0), result(1.0, ate=2.5)])[0].holds
    assert not judge_pooled(bound, [result(1.0, ate=1.0), result(1.0, ate=3.5)])[0].holds
    (broken,) = judge_pooled(bound, [result(1.0), result(1.0, complete=False)])
    assert not broken.holds
    assert broken.measured == "one is incomplete: 1 of 2 drives, the first: one: lost"
    assert "no drive has finished" in judge_pooled(bound, [])[0].measured
