"""How sure a ranking is: what is tried, what is kept of it, and what is rejected."""

import json
from pathlib import Path

import pytest

from vislam.base.errors import DataError
from vislam.compare import main
from vislam.comparison import config as configuration
from vislam.comparison.results import Results
from vislam.evaluation.spread import Spread
from vislam.study.robustness import neighbourhood, spread_rows

CONFIGS = Path(__file__).parents[2] / "configs"
SPREAD = Spread(
    "ate_rmse",
    ("as configured", "held_out.seed 1", "gate_probability 0.9"),
    {("one", "filtered"): (1.0, 1.4, 0.9), ("two", "filtered"): (1.2, 1.5, None)},
)


def test_what_is_tried_is_around_the_settings_that_are_on():
    assert neighbourhood(configuration.load(CONFIGS / "ds3.yaml")) == {
        "held_out.seed": (1, 2, 3),
        "data.repair.disparity.minimum_px": (2.0, 3.5),
        "data.repair.consensus.threshold": (4.0, 7.0),
        "gate_probability": (0.999, 0.99999),
    }
    plain = neighbourhood(configuration.load(CONFIGS / "ci.yaml"))
    assert list(plain) == ["held_out.seed", "gate_probability"]


@pytest.mark.parametrize("name", ["ds3", "kitti07"])
def test_the_shipped_studies_try_the_same(name):
    config = configuration.load(CONFIGS / f"robustness_{name}.yaml")
    shipped = {path: tuple(values) for path, values in config.study["around"].items()}
    assert shipped == neighbourhood(configuration.load(CONFIGS / f"{name}.yaml"))


def test_a_difference_is_of_two_runs_at_the_same_point():
    assert SPREAD.range_of("one", "filtered") == (0.9, 1.4)
    assert SPREAD.difference("two", "one", "filtered") == pytest.approx((0.1, 0.2))
    assert SPREAD.difference("two", "one", "smoothed") is None
    assert spread_rows(SPREAD)[1][0] == ("one", "filtered", "1.00", "0.90", "1.40", "0.50")


def test_what_is_written_is_read_and_what_is_broken_is_refused(tmp_path):
    path = tmp_path / "robustness.json"
    assert Spread.read(path) is None
    path.write_text(json.dumps(SPREAD.record()))
    assert Spread.read(path) == SPREAD
    broken = [{**SPREAD.record(), "points": ["a"]}, {**SPREAD.record(), "key": "none"}, [], "", {"key": 1}]
    for text in ("{", "NaN", *map(json.dumps, broken)):
        path.write_text(text)
        with pytest.raises(DataError, match=r"robustness.json: expected the robustness .* again"):
            Spread.read(path)


@pytest.mark.slow
def test_a_comparison_with_robustness_says_what_the_settings_do(tmp_path, capsys):
    asked = ["--config", str(CONFIGS / "tiny.yaml"), "--no-report", "--estimators", "ekf,eks"]
    assert main([*asked, "--workers", "1", "--robustness", "--out", str(tmp_path)]) == 0
    (folder,) = tmp_path.iterdir()
    results = Results.load(folder)
    assert results.spread.points[0] == "as configured"
    assert set(results.spread.values) == {("ekf", "filtered"), ("eks", "filtered"), ("eks", "smoothed")}
    document = json.loads((folder / "metrics.json").read_text())
    assert document["robustness"] == results.spread.record()
    own = {(m["estimator"], m["key"], m["estimate"]): m["value"] for m in document["metrics"]}
    for (name, estimate), values in results.spread.values.items():
        assert values[0] == pytest.approx(own[name, "ate_rmse", estimate], rel=1e-6)
    assert "over 10 settings" in capsys.readouterr().out


def test_workers_without_robustness_are_refused(capsys):
    assert main(["--config", str(CONFIGS / "tiny.yaml"), "--workers", "2"]) == 2
    assert "--workers is the number of processes of --robustness" in capsys.readouterr().err
