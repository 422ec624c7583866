"""Two workers against one, on a tiny study: it counts right; no time is judged."""

from dataclasses import replace

import pytest

from experiments import study_scaling


@pytest.mark.slow
def test_the_same_trials_run_with_one_worker_and_with_two(short_config):
    config = replace(short_config, estimators={"dead_reckoning": {}, "ekf": {}})
    found = study_scaling.scaling(config, trials=3).values
    one, two = found["workers"].values()
    assert found["ratio"] == one["trials_s"] / two["trials_s"]
    for run in (one, two):
        assert min(run["start_s"], run["trials_s"]) > 0.0
        assert 0.0 < run["busy"] < 1.5


@pytest.mark.parametrize(
    ("arguments", "said"),
    [(["--trials", "0"], "--trials must be at least 1, got 0"), (["--out", "."], "cannot be written")],
)
def test_bad_arguments_are_one_line_and_exit_code_2(arguments, said, capsys):
    assert study_scaling.main(arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
