"""Checks on the command line: exit codes, JUnit XML, and results compared with saved ones."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest

from vislam.compare import main

TINY = Path(__file__).parents[2] / "configs" / "tiny.yaml"
LOOSE = "[{metric: ate_rmse, estimator: ekf, at_most: 1.0}]"
IMPOSSIBLE = (
    "[{metric: ate_rmse, estimator: ekf, at_most: 0.0}, {metric: ate_rmse, estimator: ekf, at_most: 1}]"
)


@pytest.fixture(autouse=True)
def elsewhere(monkeypatch, tmp_path):
    monkeypatch.delenv("VISLAM_DATA", raising=False)
    monkeypatch.chdir(tmp_path)


def command(out="out", *more, checks="[]"):
    text = f"extends: {TINY}\ndata: {{simulation: {{frames: 15}}}}\nestimators: {{ekf: {{}}}}\n"
    Path("c.yaml").write_text(f"{text}checks: {checks}\n", encoding="utf-8")
    return main(["--config", "c.yaml", "--out", out, "--no-report", *more])


def metrics(out="out"):
    return next(Path(out).rglob("metrics.json"))


def cases(path):
    return {case.get("name"): case for case in ElementTree.parse(path).getroot().iter("testcase")}


def test_checks_that_hold_give_0_and_one_that_does_not_gives_3(capsys):
    assert command("good", "--junit", "good.xml", checks=LOOSE) == 0
    assert "holds  ekf ate_rmse at most 1 m: " in capsys.readouterr().out
    assert list(cases("good.xml")) == ["completes", "ekf ate_rmse at most 1 m"]
    assert command("bad", "--junit", "bad.xml", checks=IMPOSSIBLE) == 3
    shown = capsys.readouterr().out
    assert "FAILS  ekf ate_rmse at most 0 m: 0." in shown
    (failed, held) = json.loads(metrics("bad").read_text())["checks"]
    assert (failed["holds"], held["holds"]) == (False, True)
    assert (failed["estimator"], failed["name"]) == ("ekf", "ate_rmse")
    assert failed["measured"] in shown
    found = cases("bad.xml")
    assert found["ekf ate_rmse at most 0 m"].find("failure").text == failed["measured"]
    assert found["ekf ate_rmse at most 1 m"].find("failure") is None


def test_a_failed_estimator_gives_1_whatever_the_checks(monkeypatch):
    from vislam.base.errors import DivergedError
    from vislam.estimators.ekf import EkfEstimator

    whole = EkfEstimator.process

    def failing(self, frame):
        if frame.k == 12:
            raise DivergedError("covariance lost")
        return whole(self, frame)

    monkeypatch.setattr(EkfEstimator, "process", failing)
    assert command("out", "--junit", "out.xml", checks=LOOSE) == 1
    found = cases("out.xml")
    assert found["completes"].find("error").get("message") == "frame 12: DivergedError: covariance lost"
    (check,) = json.loads(metrics().read_text())["checks"]
    assert not check["holds"]


MISTAKES = {
    "an unknown run": (
        "[{metric: ate_rmse, estimator: ukf, at_most: 1}]",
        [],
        "checks.0.estimator: expected",
    ),
    "an unknown key": ("[{metric: ate_rmse, estimator: ekf, most: 1}]", [], "checks.0.most: unknown key"),
    "nothing saved": (
        "[{metric: ate_rmse, estimator: ekf, at_most: 1, times: saved}]",
        [],
        "name them with --against results/<id>",
    ),
    "no such file": ("[]", ["--against", "nowhere"], "nowhere: cannot be read"),
    "no place for the XML": ("[]", ["--junit", "."], "cannot be written ("),
    "a negative tolerance": ("[]", ["--tolerance", "-1"], "--tolerance must be >= 0 and finite, got -1.0"),
    "no bound": ("[]", ["--tolerance", "inf"], "--tolerance must be >= 0 and finite, got inf"),
    "no number": ("[]", ["--tolerance", "nan"], "--tolerance must be >= 0 and finite, got nan"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_gets_one_line_and_2_before_anything_runs(case, capsys):
    checks, more, message = MISTAKES[case]
    assert command("out", *more, checks=checks) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not Path("out").exists()


def test_a_rerun_is_no_worse_than_what_was_saved_and_a_worse_one_is(capsys):
    assert command("old") == 0
    assert command("new", "--against", str(metrics("old").parent)) == 0
    said = capsys.readouterr().out
    assert re.search(r"^all \d\d checks hold$", said, re.MULTILINE)
    assert "holds  " not in said
    names = {check["name"] for check in json.loads(metrics("new").read_text())["checks"]}
    assert {"ate_rmse", "rpe_5m_rmse", "map_error_median"} <= names
    assert not any("time" in name or "rss" in name for name in names)
    # Told that its inertial data is far better than it is, the filter comes out worse.
    wrong = ["--set", "noise.twist_density=[1.e-6, 1.e-6, 1.e-6, 1.e-5, 1.e-5, 1.e-5]"]
    assert command("worse", "--against", str(metrics("old")), *wrong) == 3
    assert "FAILS  ekf filtered ate_rmse at most 1.05 times the saved" in capsys.readouterr().out


def test_a_check_of_its_own_says_how_much_worse_it_may_be():
    check = "[{metric: ate_rmse, estimator: ekf, at_most: 0.9, times: saved}]"
    assert command("old") == 0
    assert command("new", "--against", "old/" + metrics("old").parent.name, checks=check) == 3
    (verdict,) = json.loads(metrics("new").read_text())["checks"]
    assert verdict["check"] == "ekf ate_rmse at most 0.9 times the saved"


def test_saved_results_of_other_data_get_2(capsys):
    assert command("old") == 0
    assert command("new", "--against", str(metrics("old")), "--seed", "2") == 2
    assert "of other data (simulation, digest " in capsys.readouterr().err
    assert not Path("new").exists()


def test_saved_results_with_another_reference_get_2(capsys):
    assert command("old") == 0
    document = json.loads(metrics("old").read_text())
    document["dataset"]["reference"] = None
    Path("other.json").write_text(json.dumps(document), encoding="utf-8")
    assert command("new", "--against", "other.json") == 2
    assert "other.json: scored against no reference, here it is truth" in capsys.readouterr().err


BROKEN = {
    "not JSON": (lambda text: text[:40], "not a metrics.json"),
    "not a mapping": (lambda text: "[1]", "expected a mapping of keys, got list"),
    "another schema": (
        lambda text: text.replace('"schema_version": 2', '"schema_version": 99'),
        "schema_version must be 2, got 99",
    ),
    "no dataset": (lambda text: '{"schema_version": 2}', "dataset: Field required"),
    "a value that is none": (
        lambda text: text.replace(
            "[]", '[{"estimator": "ekf", "key": "ate_rmse", "estimate": null, "value": null}]'
        ),
        "metrics.0.value: Input should be a valid number, got None",
    ),
}


@pytest.mark.parametrize("case", BROKEN)
def test_broken_saved_results_get_one_line_and_2(case, capsys):
    change, message = BROKEN[case]
    dataset = {"name": "s", "digest": "d", "reference": None}
    whole = {"schema_version": 2, "dataset": dataset, "runs": {}, "metrics": []}
    Path("broken.json").write_text(change(json.dumps(whole)), encoding="utf-8")
    assert command("out", "--against", "broken.json") == 2
    said = capsys.readouterr().err
    assert said.startswith("vislam: broken.json: ")
    assert message in said
    assert said.count("\n") == 1
    assert not Path("out").exists()


def test_checks_of_others_are_left_out_aloud(capsys):
    text = f"extends: {TINY}\nchecks: [{{metric: ate_rmse, estimator: isam2, at_most: 0}}]\n"
    Path("c.yaml").write_text(text, encoding="utf-8")
    assert main(["--config", "c.yaml", "--estimators", "ekf", "--dump-config"]) == 0
    shown = capsys.readouterr()
    assert "checks: []" in shown.out
    assert shown.err.startswith("1 of 1 checks need estimators that do not run")
