"""One trial: what it returns, and that it is pure."""

import logging
from dataclasses import replace

import pytest

from vislam.identity import code_digest
from vislam.study.points import Point
from vislam.study.trial import run_trial


@pytest.fixture(scope="module")
def tree(short_config):
    return Point.of(replace(short_config, estimators={"dead_reckoning": {}, "ekf": {}}), {}).tree


def timeless(result):
    metrics = [m for m in result["metrics"] if not m["key"].endswith(("_ms", "_s", "_mb"))]
    return metrics, result["statistics"]


def test_a_trial_is_a_function_of_config_and_seed(tree):
    first, again, other = run_trial(tree, 3), run_trial(tree, 3), run_trial(tree, 4)
    assert (first["status"], first["reason"], first["code"]) == ("done", "", code_digest())
    assert timeless(first) == timeless(again)
    errors = [
        {m["estimator"]: m["value"] for m in result["metrics"] if m["key"] == "ate_rmse"}
        for result in (first, other)
    ]
    assert errors[0].keys() == {"dead_reckoning", "ekf"}
    assert errors[0]["ekf"] != errors[1]["ekf"]
    assert "nees_pose" in {s["name"] for s in first["statistics"] if s["estimator"] == "ekf"}


def test_a_trial_that_raises_is_a_result(tree):
    data = {**tree["data"], "simulation": {**tree["data"]["simulation"], "frames": -1}}
    found = run_trial({**tree, "data": data}, 0)
    assert found["status"] == "failed"
    assert found["reason"].startswith("ConfigError: data.simulation.frames")
    assert found["metrics"] == []


def test_an_incomplete_estimator_is_named_and_not_scored(tree, monkeypatch):
    import vislam.running

    whole = vislam.running.estimator.run

    def stopped(solver, *args, name, **kwargs):
        run = whole(solver, *args, name=name, **kwargs)
        return replace(run, error="frame 7: lost") if name == "ekf" else run

    monkeypatch.setattr(vislam.running.estimator, "run", stopped)
    found = run_trial(tree, 0)
    assert (found["status"], found["reason"]) == ("done", "ekf: frame 7: lost")
    assert found["runs"]["ekf"] == {"complete": False, "error": "frame 7: lost"}
    assert {m["estimator"] for m in found["metrics"]} == {"dead_reckoning"}


def test_a_trial_leaves_the_log_as_it_was(tree, caplog):
    log = logging.getLogger("vislam")
    level = log.level
    run_trial(tree, 0)
    assert log.level == level
    assert caplog.records == []
