"""The report's pipeline beside ours, on short simulated drives."""

import json
from pathlib import Path

import pytest

from benchmarks.report_pipeline import FIGURES, QUOTED_S, TIMED, main

OURS = """
name: ours
data: {simulation: {frames: 30, tracks_in_view: 40}}
held_out: {share: 0.0}
estimators: {dead_reckoning: {}, ekf: {}, isam2: {}}
"""
REPORT = """
extends: ours.yaml
name: report
estimators:
  dead_reckoning: {integration: first}
  mapping_only: {every: 2}
  mapping_only_all: {estimator: mapping_only, every: 1}
  report_ekf: {every: 2}
  report_ekf_slowed: {estimator: report_ekf, every: 2, pose_gain: 0.01}
"""


@pytest.fixture
def configs(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("ours.yaml").write_text(OURS, encoding="utf-8")
    Path("report.yaml").write_text(REPORT, encoding="utf-8")
    return ["--report", "report.yaml", "--ours", "ours.yaml"]


@pytest.mark.slow
def test_it_tells_times_and_errors_of_both_and_draws_them(configs, capsys):
    assert main([*configs, "--out", "numbers.json", "--figure", "figure.png"]) == 0
    shown = capsys.readouterr().out
    assert "[SIMULATED]" in shown
    parts = json.loads(Path("numbers.json").read_text(encoding="utf-8"))["parts"]
    assert parts["times"]["seconds"].keys() == TIMED.keys()
    wanted = {f"report {one}" for _, one, _ in FIGURES} | {f"ours {other}" for _, _, other in FIGURES}
    assert wanted <= parts["errors"].keys()
    assert parts["errors"]["ours isam2"]["error_m"] < parts["errors"]["report report_ekf"]["error_m"]
    assert Path("figure.png").read_bytes().startswith(b"\x89PNG")
    assert QUOTED_S == 60.0


def test_a_run_that_is_missing_is_named(configs, capsys):
    Path("report.yaml").write_text(
        REPORT.replace("  mapping_only_all: {estimator: mapping_only, every: 1}\n", "")
    )
    assert main(configs) == 2
    assert "report.yaml: expected a run mapping_only_all among the estimators" in capsys.readouterr().err
