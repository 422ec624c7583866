"""Sentences of a study say what the trials hold, and no more."""

import pytest

from tests.study.synthetic import lost, record, study
from vislam.study.page.labels import parameter_label, setting
from vislam.study.page.verdict import consistency, verdict
from vislam.study.trials import Trials

NOISE = "data.simulation.pixel_sigma_px"


def test_overconfidence_is_told_from_the_value_where_it_sets_in():
    sweep = {NOISE: (4.0, 0.5, 1.0, 2.0)}
    records = study(sweep, seeds=40, overconfident=lambda point: 3.0 if point[NOISE] >= 2.0 else 1.0)
    trials = Trials.of_records(records)
    told = consistency(trials, "ekf")
    assert told.startswith("ekf is overconfident from pixel sigma 2 px on: NEES ")
    assert "overconfident from" not in consistency(trials, "isam2")


def test_overconfidence_that_does_not_stay_is_told_by_points():
    sweep = {NOISE: (0.5, 1.0, 2.0)}
    records = study(sweep, seeds=40, overconfident=lambda point: 3.0 if point[NOISE] == 1.0 else 0.8)
    told = consistency(Trials.of_records(records), "ekf")
    assert told.startswith("ekf is overconfident at 1 of 3 points, most at pixel sigma 1 px: NEES ")


@pytest.mark.parametrize(
    ("expected", "word"),
    [(3.0, "is overconfident"), (0.3, "is conservative")],
)
def test_without_a_sweep_the_claim_is_judged_as_it_is(expected, word):
    trials = Trials.of_records(study({}, seeds=40, overconfident=lambda _: expected))
    assert consistency(trials, "ekf").startswith(f"ekf {word}: NEES ")


def test_with_few_seeds_nobody_is_accused_or_ranked():
    trials = Trials.of_records(study({}, seeds=5, overconfident=lambda _: 50.0))
    assert consistency(trials, "ekf") == "too few seeds to judge the consistency of ekf: 5 of at least 6."
    told = " ".join(verdict(trials))
    assert "too few trials of both to rank them: 5 of at least 6" in told
    assert "overconfident" not in told


def test_words_have_no_place_from_which_on():
    sweep = {"estimators.ekf.form": ("right", "left")}
    told = consistency(Trials.of_records(study(sweep, overconfident=lambda _: 3.0)), "ekf")
    assert told.startswith("ekf is overconfident at 2 of 2 points, most at form ")


def test_the_better_one_is_named_with_its_difference():
    told = " ".join(verdict(Trials.of_records(study({}, seeds=30))))
    assert "30 trials, all of them carried out." in told
    assert "Every run finished." in told
    assert "on the same trials isam2 less ekf is -0." in told


def test_equal_ones_are_not_ranked():
    records = [
        record(seed, {}, {"a": {"ate_rmse": 1.0 + seed}, "b": {"ate_rmse": 1.0 + seed}}) for seed in range(9)
    ]
    assert "a and b cannot be told apart (p 1)" in " ".join(verdict(Trials.of_records(records)))


def test_failures_are_told_first():
    records = [record(seed, {}, {"ekf": {}}, failed=("ekf",) if seed == 0 else ()) for seed in range(9)]
    told = verdict(Trials.of_records([*records, lost(9, {})]))
    assert told == [
        "10 trials; 1 of them failed as a whole.",
        "Runs that did not finish: ekf 11.1 % (1.99 to 43.5).",
    ]


def test_a_study_without_runs_says_so():
    assert "No run was started" in " ".join(verdict(Trials.of_records([lost(0, {})])))
    assert verdict(Trials.of_records([]))[0].startswith("0 trials")


def test_parameters_are_named_with_their_unit():
    assert parameter_label(NOISE) == "pixel sigma [px]"
    assert setting(NOISE, 0.5) == "pixel sigma 0.5 px"
    assert setting("data.simulation.frames", 30) == "frames 30"
    assert setting("data.gyro_bias", (0.0, 0.1)) == "gyro bias 0 0.1"
