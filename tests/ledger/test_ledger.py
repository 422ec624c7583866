"""The ledger: what is found, filtered, sorted, exported, compared, and shown as a page."""

import csv
import json
import re
from pathlib import Path

import pytest

from tests.report.test_page import EVIL, Elements
from vislam.base.errors import ConfigError
from vislam.cli.results import main
from vislam.ledger.diff import differences
from vislam.ledger.entries import find, read
from vislam.ledger.select import order, select
from vislam.ledger.table import headline


def comparison(folder, *, day, error, name="ds3", commit="a" * 40, noise=0.5):
    """A saved comparison of two runs."""
    folder.mkdir(parents=True)
    values = {("isam2", "ate_rmse", "smoothed"): error, ("ekf", "ate_rmse", "filtered"): 2.0 * error}
    values |= {("isam2", "total_time_s", "smoothed"): 20.0, ("ekf", "nees_pose", "filtered"): 12.5}
    document = {
        "schema_version": 2,
        "name": name,
        "dataset": {"name": "03", "synthetic": False, "digest": "d", "reference": "truth"},
        "runs": {"ekf": {"complete": True}, "isam2": {"complete": True}},
        "provenance": {"date": f"2026-11-{day:02} 10:00 UTC", "commit": commit, "code": "c1"},
        "metrics": [
            {"estimator": run, "key": key, "estimate": estimate, "value": value}
            for (run, key, estimate), value in values.items()
        ],
        "checks": [{"holds": True}, {"holds": error < 1.0}],
    }
    (folder / "metrics.json").write_text(json.dumps(document))
    (folder / "config.yaml").write_text(f"name: {name}\nnoise: {{pixel_sigma_px: {noise}}}\nseed: 1\n")
    (folder / "report.html").write_text("<p>")


@pytest.fixture
def results(tmp_path):
    comparison(tmp_path / "results" / "ds3-1", day=1, error=0.8)
    comparison(
        tmp_path / "results" / "ds3-2", day=2, error=1.2, commit=f"{'b' * 40}, with changes", noise=0.7
    )
    comparison(tmp_path / "results" / "evil", day=3, error=5.0, name=EVIL)
    study = tmp_path / "studies" / "s-1"
    (study / "trials").mkdir(parents=True)
    config = {"data": {"file": None, "simulation": {}}, "estimators": {"ekf": {}}}
    counts = {"done": 3, "failed": 1, "lost": 0}
    document = {"schema_version": 1, "name": "s", "config": config, "points": 1, "seeds": 4, "counts": counts}
    (study / "study.json").write_text(
        json.dumps({**document, "provenance": {"date": "2026-11-04 10:00 UTC"}})
    )
    (study / "trials.csv").write_text("id,ekf.ate_rmse.filtered,ekf.rpe\na,1.0,3\nb,,3\nc,3.0,3\nd,9.0,3\n")
    (study / "trials" / "metrics.json").write_text("{}")
    seen = tmp_path / "inspection"
    seen.mkdir()
    findings = [{"check": "clock", "verdict": "fault"}, {"check": "stamps", "verdict": "ok"}]
    inspection = {"schema_version": 1, "name": "03", "synthetic": True, "findings": findings}
    (seen / "inspection.json").write_text(json.dumps(inspection))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "metrics.json").write_text('{"accuracy": 1}')
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metrics.json").write_text("{")
    return tmp_path


def test_every_kind_is_found_and_read(results):
    found = {entry.folder.name: entry for entry in find(results)}
    assert found.keys() == {"ds3-1", "ds3-2", "evil", "s-1", "inspection", "broken"}
    assert headline(found["ds3-1"]) == "isam2 0.80 m (smoothed); ekf 1.60 m (filtered)"
    assert found["ds3-1"].checks == (2, 2)
    assert found["ds3-1"].commit == "a" * 10
    assert found["ds3-2"].commit == "b" * 10 + "+"
    assert headline(found["s-1"]) == "ekf 3.00 m (filtered); 1 points, 4 seeds, 1 lost or failed"
    assert headline(found["inspection"]) == "faults: clock"
    assert found["inspection"].data == "03 [SIMULATED]"
    assert headline(found["broken"]).startswith("cannot be used: ")
    newest = [entry.folder.name for entry in find(results) if entry.provenance.get("date")]
    assert newest == ["s-1", "evil", "ds3-2", "ds3-1"]


@pytest.mark.parametrize(
    ("condition", "names"),
    [
        ("kind=study", {"s-1"}),
        ("config=ds3", {"ds3-1", "ds3-2"}),
        ("estimators=isam2", {"ds3-1", "ds3-2", "evil"}),
        ("estimators!=ekf", {"inspection", "broken"}),
        ("isam2.ate_rmse<1", {"ds3-1"}),
        ("isam2.ate_rmse.smoothed>=1.2", {"ds3-2", "evil"}),
        ("error<=0.8", {"ds3-1"}),
        ("checks<1", {"ds3-2", "evil", "inspection"}),
        ("when<2026-11-02", {"ds3-1"}),
        ("commit=aaaaaaaaaa", {"ds3-1", "evil"}),
    ],
)
def test_entries_are_filtered(results, condition, names):
    found = select(find(results), [condition])
    assert {entry.folder.name for entry in found} == names


def test_entries_are_sorted_and_those_without_a_value_come_last(results):
    found = find(results)
    names = [entry.folder.name for entry in order(found, "error", descending=False)]
    assert names[:4] == ["ds3-1", "ds3-2", "s-1", "evil"]
    assert [entry.folder.name for entry in order(found, "error", descending=True)][:2] == ["evil", "s-1"]
    assert set(names[4:]) == {"inspection", "broken"}
    for bad in ("nothing", "error~1", "error<many"):
        with pytest.raises(ConfigError):
            select(found, [bad if "~" in bad or "<" in bad else f"{bad}=1"])


def test_what_differs_is_said_and_nothing_else(results):
    one, other = read(results / "results" / "ds3-1"), read(results / "results" / "ds3-2")
    found = differences(one, other)
    assert found["config"].rows == [["noise.pixel_sigma_px", "0.5", "0.7"]]
    assert found["data"].rows == []
    assert [row[0] for row in found["code"].rows] == ["date", "commit"]
    assert found["figures"].rows[0] == ["isam2.ate_rmse.smoothed [m]", "0.80", "1.20", "+0.40 (+50.0 %)"]
    assert not any(table.rows for table in differences(one, one).values())


def test_the_command_lists_exports_and_writes_a_page(results, capsys):
    table = results / "all.csv"
    assert main([str(results), "--export", str(table), "--sort", "error"]) == 0
    out = capsys.readouterr().out
    assert "isam2 0.80 m (smoothed); ekf 1.60 m (filtered)" in out
    rows = list(csv.DictReader(table.read_text(encoding="utf-8").splitlines()))
    by = {(Path(row["folder"]).name, row["estimator"]): row for row in rows}
    assert float(by["ds3-2", "isam2"]["error"]) == 1.2
    assert float(by["ds3-2", "ekf"]["NEES"]) == 12.5
    assert by["inspection", ""]["error"] == ""
    text = (results / "index.html").read_text(encoding="utf-8")
    elements = Elements(text)
    assert not elements.open
    assert "<script>alert" not in text
    assert not re.search("https?:", text)
    links = [link["href"] for link in elements.all("a") if link["href"].endswith("report.html")]
    assert sorted(links) == [f"results/{name}/report.html" for name in ("ds3-1", "ds3-2", "evil")]
    assert all((results / link).is_file() for link in links)
    assert len(elements.all("figure")) == 3


def test_the_same_as_parquet(results):
    parquet = pytest.importorskip("pyarrow.parquet")
    table = results / "all.parquet"
    assert main([str(results), "--export", str(table), "--no-page", "--where", "config=ds3"]) == 0
    found = parquet.read_table(table).to_pydict()
    assert sorted(found["error"]) == [0.8, 1.2, 1.6, 2.4]
    assert not (results / "index.html").exists()


def test_bad_input_is_one_line_and_2(results, capsys):
    good = str(results / "results" / "ds3-1")
    for arguments, message in (
        ([str(results / "none")], "expected a folder with results"),
        ([str(results), "--export", str(results / "a.xlsx")], "ends in .csv or .parquet"),
        ([str(results), "--sort", "beauty"], "no such key"),
        (["diff", good, str(results / "other")], "got no metrics.json"),
        (["diff", good, str(results / "broken")], "cannot be used"),
    ):
        assert main(arguments) == 2
        said = capsys.readouterr().err
        assert message in said
        assert len(said.strip().splitlines()) == 1


def test_diff_says_what_is_the_same(results, capsys):
    assert main(["diff", *(str(results / "results" / name) for name in ("ds3-1", "ds3-2"))]) == 0
    out = capsys.readouterr().out
    assert "noise.pixel_sigma_px" in out
    assert "+0.40 (+50.0 %)" in out
    assert "no difference in data" in out
    assert main([str(results / "inspection" / ".."), "--where", "config=none", "--no-page"]) == 0
    assert "no result that meets the conditions" in capsys.readouterr().out
