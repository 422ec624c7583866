"""The page of a study: whole, of its own and safe, whatever was swept and whatever failed."""

import re

import pytest

from tests.report.test_page import EVIL, Elements
from tests.study.synthetic import lost, record, study
from vislam.study.page.figures import all_figures
from vislam.study.page.page import write_study_page
from vislam.study.page.tables import consistency_table, ranking_table
from vislam.study.settings import Ranking
from vislam.study.trials import Trials

PIXELS = {"noise.pixel_sigma_px": [0.25, 0.5, 1.0]}
FORMS = {**PIXELS, "gates_from": ["ekf", None]}


def page(folder, records, **changes):
    parts = {"title": "study", "notes": (), "config": "name: study", "provenance": "code: 1", **changes}
    write_study_page(folder / "study.html", trials=Trials.of_records(records), **parts)
    return (folder / "study.html").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("sweep", "wanted"),
    [
        ({}, {"nees_filtered", "cost_filtered"}),
        (PIXELS, {"response_filtered", "nees_filtered", "cost_filtered"}),
        (FORMS, {"response_filtered", "heat_map_filtered", "nees_filtered", "cost_filtered"}),
    ],
    ids=["seeds", "one parameter", "two parameters"],
)
def test_each_kind_of_study_has_its_figures(sweep, wanted):
    assert set(all_figures(Trials.of_records(study(sweep, seeds=5)))) == wanted


@pytest.mark.slow
def test_the_page_is_whole_and_fetches_nothing(tmp_path):
    records = study(PIXELS, overconfident=lambda point: 5.0 if point["noise.pixel_sigma_px"] > 0.4 else 1.0)
    text = page(tmp_path, records)
    elements = Elements(text)
    assert not elements.open
    assert not re.search("https?:", text)
    assert "ekf is overconfident from pixel sigma 0.5 px on" in text
    assert [tag for tag, _ in elements.found if tag == "h1"] == ["h1"]
    assert len(elements.all("svg")) == len(elements.all("figure")) == 3
    assert "default-src 'none'" in text
    assert text == page(tmp_path, records)


def test_what_failed_is_listed_with_its_reason(tmp_path):
    values = {"ekf": {"ate_rmse": 1.0}, "isam2": {"ate_rmse": 1.0}}
    records = [record(seed, {}, values, failed=("ekf",) if seed == 2 else ()) for seed in range(4)]
    text = page(tmp_path, [*records, lost(4, {}, "disk full")])
    assert "ekf: diverged" in text
    assert "disk full" in text
    assert "25 %" in text
    assert 'id="figure-failures"' in text


def test_nothing_finished_is_a_page_too(tmp_path):
    text = page(tmp_path, [lost(seed, {}, "no landmarks") for seed in range(3)])
    assert not Elements(text).open
    assert "no landmarks" in text


def test_names_reasons_and_notes_are_text(tmp_path):
    records = [record(0, {EVIL: EVIL}, {EVIL: {"ate_rmse": 1.0}}), lost(1, {EVIL: EVIL}, EVIL)]
    text = page(tmp_path, records, title=EVIL, notes=(EVIL,), config=EVIL, provenance=EVIL)
    assert "<script>alert" not in text
    assert not Elements(text).open


def test_what_else_speaks_for_consistency_is_a_column_where_there_is_any():
    plain = consistency_table(Trials.of_records(study({})))
    assert plain.header[-1] == "errors within 3 sigma"
    records = study({})
    for item in records:
        for key, value in (("nis_per_dof", 1.25), ("spurious_yaw_information", 1e-9 * 10.0 ** item["seed"])):
            item["metrics"].append({"estimator": "ekf", "key": key, "value": value})
    table = consistency_table(Trials.of_records(records))
    assert table.header[-2:] == ["NIS per degree of freedom", "spurious yaw information [1/rad²]"]
    ekf, isam2 = table.rows
    assert ekf[-2].startswith("1.25 ")
    # The median of 1e-9 to 1e2, not the mean that the last one rules.
    assert float(ekf[-1].split()[0]) < 0.001
    assert isam2[-2:] == ["-", "-"]


def test_ranks_have_a_section_of_their_own(tmp_path):
    ranking = Ranking(by="nees_pose", errors=("ate_rmse", "rpe_10m_rmse"))
    records = study({}, seeds=3)
    for item in records:
        item["seed"] = 0
    text = page(tmp_path, records, ranking=ranking)
    assert not Elements(text).open
    assert 'id="ranking"' in text
    assert "rank correlation with NEES of the pose per degree of freedom" in text
    first, second = ranking_table(Trials.of_records(records), ranking).rows
    assert first[:2] == ["ATE [m]", "1"]
    assert second == ["rpe_10m_rmse", "0", "-"]
