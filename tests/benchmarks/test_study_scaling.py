"""The benchmark of two workers against one, on a tiny study: it counts right; no time is judged."""

import json
from dataclasses import replace

import pytest

from benchmarks import study_scaling


@pytest.mark.slow
def test_the_same_trials_run_with_one_worker_and_with_two(short_config, tmp_path, capsys):
    config = replace(short_config, estimators={"dead_reckoning": {}, "ekf": {}})
    study_scaling.run(config, trials=3, repeats=1, out=tmp_path / "scaling.json")
    found = json.loads((tmp_path / "scaling.json").read_text())["parts"]["scaling"]
    one, two = found["runs"]
    assert (found["trials"], one["workers"], two["workers"]) == (3, 1, 2)
    assert found["ratio"] == one["trials_s"] / two["trials_s"]
    for run in (one, two):
        assert min(value for key, value in run.items() if key.endswith("_s")) > 0.0
        assert run["worker_cpu_s"] < 1.5 * run["workers"] * run["trials_s"]
    assert "scaling: 3 trials" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--trials", "0"], "--trials must be at least 1, got 0"),
        (["--frames", "-1"], "--frames must be at least 1, got -1"),
        (["--repeats", "0"], "--repeats must be at least 1, got 0"),
        (["--out", "."], "cannot be written"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_code_2(arguments, said, capsys):
    assert study_scaling.main(arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
