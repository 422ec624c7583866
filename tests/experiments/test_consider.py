"""The table of covariances beside the estimators' own, from a small comparison."""

import pytest

from experiments.consider import add, page, settings, table
from vislam import compare
from vislam.comparison.config import ORDINARY, ConsiderConfig


@pytest.fixture(scope="module")
def outcome():
    consider = ConsiderConfig(clock=0.01)
    return compare(
        "tiny", estimators=["ekf"], data__simulation__frames=8, common_set_from=(), consider=consider
    )


def test_a_row_has_what_there_is_of_a_run_and_what_several_folders_have_is_put_together(outcome):
    rows = {}
    add(rows, "tiny", outcome.results, outcome.evaluation)
    ((entry, row),) = rows.items()
    assert entry == ("tiny", "ekf", "filtered")
    assert row["nees_considered"] == outcome.metric("nees_pose_considered", "ekf")
    assert row["runs_considered"] == 1
    row["ate"] = 123.0
    add(rows, "tiny", outcome.results, outcome.evaluation)
    assert rows[entry]["ate"] == 123.0
    *_, line = table(rows)
    assert line.startswith("| tiny | `ekf` causal | 123.00 | ")
    assert line.count("|") == 9
    assert line.endswith("(1) / - |")


def test_the_page_has_the_setting(outcome):
    told = page({}, {}, "machine")
    for line in settings():
        assert f"- {line}" in told
    assert len(list(settings())) == len({name for name, _, _ in ORDINARY.components()})
