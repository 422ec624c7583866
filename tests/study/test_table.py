"""The table of a study's trials in its two forms."""

import csv
import math

import pytest

from vislam.study.folder import StudyFolder
from vislam.study.points import Point, Trial
from vislam.study.table import csv_table, kind_of
from vislam.study.trial import DONE

POINTS = [
    {"noise.pixel_sigma_px": 1.0, "kernel": None},
    {"noise.pixel_sigma_px": 2, "kernel": {"degrees_of_freedom": 3}},
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A study of four trials, of which one has no metric."""
    results = {}
    for number in range(4):
        trial = Trial(f"{number:016x}", Point(POINTS[number % 2], {}), seed=number)
        values = (
            [] if number == 3 else [("ekf", "ate_rmse", "filtered", 0.1 * number), ("ekf", "nis", None, None)]
        )
        metrics = [dict(zip(("estimator", "key", "estimate", "value"), row, strict=True)) for row in values]
        results[trial.id] = (trial, {"status": DONE, "reason": "", "seconds": 1.5, "metrics": metrics})
    found = StudyFolder(tmp_path)
    monkeypatch.setattr(found, "find", lambda trial: results[trial.id][1])
    found.all = [trial for trial, _ in results.values()]
    return found


def write(folder):
    swept = {path: [values[path] for values in POINTS] for path in POINTS[0]}
    return folder.write_table(lambda: folder.all, swept=swept, metrics=[])


def test_types_of_what_is_swept():
    assert kind_of([1.0, 2]) == "double"
    assert kind_of([1, 2]) == "int64"
    assert kind_of([True, False]) == "bool"
    assert kind_of([True, 1]) == kind_of([None, 1.0]) == kind_of(["a"]) == "string"


def test_the_csv_has_a_row_for_each_trial(folder):
    assert write(folder)[0].name == "trials.csv"
    with (folder.path / "trials.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["seed"] for row in rows] == ["0", "1", "2", "3"]
    assert [row["noise.pixel_sigma_px"] for row in rows] == ["1.0", "2", "1.0", "2"]
    assert [row["kernel"] for row in rows] == ["", "{degrees_of_freedom: 3}"] * 2
    assert [row["ekf.ate_rmse.filtered"] for row in rows] == ["0.0", "0.1", "0.2", ""]


def test_parquet_has_the_same_with_types(folder, monkeypatch):
    parquet = pytest.importorskip("pyarrow.parquet", reason="needs the extra vislam[parquet]")
    # Two groups of rows and a rest.
    monkeypatch.setattr("vislam.study.table._ROW_GROUP", 3)
    assert [path.name for path in write(folder)] == ["trials.csv", "trials.parquet"]
    table = parquet.read_table(folder.path / "trials.parquet")
    with (folder.path / "trials.csv").open(encoding="utf-8", newline="") as file:
        assert table.column_names == csv.DictReader(file).fieldnames
    rows = table.to_pylist()
    assert [row["seed"] for row in rows] == [0, 1, 2, 3]
    assert [row["noise.pixel_sigma_px"] for row in rows] == [1.0, 2.0, 1.0, 2.0]
    assert [row["kernel"] for row in rows] == [None, "{degrees_of_freedom: 3}"] * 2
    assert [row["ekf.ate_rmse.filtered"] for row in rows][:3] == pytest.approx([0.0, 0.1, 0.2])
    assert rows[3]["ekf.ate_rmse.filtered"] is rows[0]["ekf.nis"] is None
    assert not any(math.isnan(row["seconds"]) for row in rows)


def test_without_pyarrow_an_earlier_one_does_not_stay(folder, monkeypatch):
    (folder.path / "trials.parquet").write_bytes(b"old")
    monkeypatch.setattr("vislam.study.folder.has_parquet", lambda: False)
    assert [path.name for path in write(folder)] == ["trials.csv"]
    assert not (folder.path / "trials.parquet").exists()


def broken_off(path):
    with csv_table(path, ["a"]) as table:
        table.write({"a": 1})
        raise RuntimeError("lost")


def test_a_table_that_breaks_off_leaves_the_one_before(tmp_path):
    path = tmp_path / "trials.csv"
    path.write_text("before")
    with pytest.raises(RuntimeError, match="lost"):
        broken_off(path)
    assert path.read_text() == "before"
