"""Cases of an ablation, and what they say of each defect."""

import itertools

import pytest

from tests.report.test_study_page import page
from tests.study.synthetic import record
from vislam.study.ablation import CASE, Ablation, changes
from vislam.study.page.ablation import cost, defects_table, mending_table, short_table, verdict
from vislam.study.trials import Trials

ABLATION = Ablation(("sign", "axes", "duplicates", "bias"))
COSTS = {"sign": 100.0, "axes": 10.0, "duplicates": 3.0, "bias": 1.0}


def records(*, failing=()):
    """Trials in which each defect costs the filter what it costs, and the other nothing but the axes."""
    found = []
    for case, present in ABLATION.cases().items():
        errors = {
            "mine": 2.0 + sum(COSTS[name] for name in present),
            "other": 1.0 + (COSTS["axes"] if "axes" in present else 0.0),
        }
        values = {name: {"ate_rmse": error, "path_length": 7.0} for name, error in errors.items()}
        found.append(record(0, {CASE: case}, values, failed=("mine",) if case in failing else ()))
    return found


def test_the_cases_are_distinct_and_go_from_all_to_none():
    cases = ABLATION.cases()
    assert len(set(cases.values())) == len(cases) == 5 + 2 * 4 - 2
    assert next(iter(cases)) == "all defects"
    assert cases["no defect"] == ()
    assert cases["from duplicates on"] == ("duplicates", "bias")
    assert cases["all but axes"] == ("sign", "duplicates", "bias")
    steps = ABLATION.one_after_the_other()
    assert all(set(after) < set(before) for before, after in itertools.pairwise(steps))


@pytest.mark.parametrize("defects", [("a",), ("a", "b"), ("a", "b", "c")])
def test_small_ablations_have_a_name_for_every_case(defects):
    ablation = Ablation(defects)
    wanted = {*ablation.one_after_the_other(), *ablation.alone(), *ablation.mended_alone()}
    assert set(ablation.cases().values()) == wanted


def test_changes_are_those_of_the_defects_that_are_present():
    defects = {"a": {"x.y": 1}, "b": {"x.z": 2, "w": 3}}
    assert changes(defects, ("b",)) == {"x.z": 2, "w": 3}
    assert changes(defects, ()) == {}


def test_a_defect_costs_what_it_adds_alone():
    trials = Trials.of_records(records())
    assert {name: cost(trials, "mine", ABLATION, name) for name in COSTS} == pytest.approx(COSTS)
    assert cost(trials, "other", ABLATION, "sign") == 0.0


def test_the_tables_follow_the_order_of_mending():
    trials = Trials.of_records(records())
    rows = short_table(trials, ABLATION).rows
    assert [list(row[1:]) for row in rows] == [
        ["116.0", "11.00"],
        ["16.00", "11.00"],
        ["6.00", "1.00"],
        ["3.00", "1.00"],
        ["2.00", "1.00"],
    ]
    assert len(mending_table(trials, ABLATION).rows) == 2 * len(rows)
    axes = defects_table(trials, ABLATION).rows[2]
    assert list(axes) == ["axes", "12.00", "11.00", "+10.00", "+10.00", "106.0", "1.00"]


def test_a_run_that_failed_is_no_number(tmp_path):
    found = records(failing=("only bias", "all defects"))
    trials = Trials.of_records(found)
    assert short_table(trials, ABLATION).rows[0][1] == "failed"
    told = verdict(trials, ABLATION)
    assert told[0].startswith("mine: ATE failed with all defects, 2.00 m with none.")
    assert "It fails with bias." in told[0]
    assert "On their own cost most: sign (+100.0 m), axes (+10.00 m)" in told[0]
    text = page(tmp_path, found, ablation=ABLATION)
    assert 'id="figure-ablation"' in text
    assert "Each defect on its own" in text


def test_nothing_finished_is_a_page_too(tmp_path):
    lost = [
        {"seed": 0, "point": {CASE: case}, "status": "failed", "reason": "x"} for case in ABLATION.cases()
    ]
    assert "Each defect on its own" not in page(tmp_path, lost, ablation=ABLATION)
