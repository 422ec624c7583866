"""One trial: what it returns, and that it is pure."""

import json
import logging
import math
from dataclasses import replace

import numpy as np
import pytest

import vislam.study.trial
from tests.records import altered
from vislam.base.errors import Interrupted
from vislam.comparison.identity import code_digest
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
    import vislam.comparison.running

    whole = vislam.comparison.running.loop.run

    def stopped(solver, *args, name, **kwargs):
        run = whole(solver, *args, name=name, **kwargs)
        return altered(run, error="frame 7: lost") if name == "ekf" else run

    monkeypatch.setattr(vislam.comparison.running.loop, "run", stopped)
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


@pytest.mark.parametrize(
    "error", [SystemExit(0), KeyboardInterrupt(), KeyError("x"), OSError(2, "no"), StopIteration()]
)
def test_whatever_an_estimator_raises_is_a_result(error, tree, monkeypatch):
    def raising(*of, **how):
        raise error

    monkeypatch.setattr(vislam.study.trial, "run_comparison", raising)
    found = run_trial(tree, 0)
    assert found["status"] == "failed"
    assert found["reason"].startswith(f"{type(error).__name__}: ")


@pytest.mark.parametrize(
    "error", [MemoryError(), OSError(28, "No space left on device"), Interrupted("SIGTERM")]
)
def test_what_is_no_fault_of_the_trial_is_raised(error, tree, monkeypatch):
    def raising(*of, **how):
        raise error

    monkeypatch.setattr(vislam.study.trial, "run_comparison", raising)
    with pytest.raises(type(error)):
        run_trial(tree, 0)


def test_a_result_is_plain_data_that_any_reader_of_json_takes(tree, monkeypatch):
    whole = vislam.study.trial.evaluate

    def odd(runs, record):
        found = whole(runs, record)
        first, second, *rest = found.metrics
        return replace(
            found, metrics=[replace(first, value=math.nan), replace(second, value=np.int64(3)), *rest]
        )

    monkeypatch.setattr(vislam.study.trial, "evaluate", odd)
    found = run_trial(tree, 0)
    assert [metric["value"] for metric in found["metrics"][:2]] == [None, 3.0]
    json.dumps(found, allow_nan=False)


def test_a_long_reason_is_cut_and_can_be_written(tree, monkeypatch):
    def raising(*of, **how):
        raise ValueError("\ud800" + "x" * 10_000)

    monkeypatch.setattr(vislam.study.trial, "run_comparison", raising)
    reason = run_trial(tree, 0)["reason"]
    assert len(reason.encode()) < 1100


def test_a_trial_says_which_files_it_read(tree, tmp_path):
    path = tmp_path / "it"
    named = {**tree, "estimators": {"dead_reckoning": {}, "ekf": {"x": str(path)}}}
    found = set()
    for text in ("", "one", "two"):
        if text:
            path.write_text(text, encoding="utf-8")
        found.add(run_trial(named, 0)["inputs"])
    assert len(found) == 3
