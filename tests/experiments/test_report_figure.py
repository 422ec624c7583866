"""The report's runs beside ours, from saved results of short simulated drives."""

from pathlib import Path

import pytest

import vislam
from experiments.report_figure import main

OURS = """
name: ours
data: {simulation: {frames: 20, tracks_in_view: 30}}
held_out: {share: 0.0}
estimators: {dead_reckoning: {}, ekf: {}, isam2: {}}
"""
REPORT = """
extends: ours.yaml
name: report
estimators:
  dead_reckoning: {integration: first}
  mapping_only: {every: 2}
  report_ekf: {every: 2}
  report_ekf_slowed: {estimator: report_ekf, every: 2, pose_gain: 0.01}
"""


@pytest.fixture
def folders(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for name, text in (("ours", OURS), ("report", REPORT)):
        Path(f"{name}.yaml").write_text(text, encoding="utf-8")
    return [str(vislam.compare(f"{name}.yaml").save()) for name in ("report", "ours")]


def test_each_run_of_the_report_is_drawn_beside_ours_and_a_missing_one_is_named(folders, capsys):
    assert main([*folders, "figure.png"]) == 0
    assert Path("figure.png").read_bytes().startswith(b"\x89PNG")
    report, ours = folders
    assert main([ours, report, "other.png"]) == 2
    assert "mapping_only" in capsys.readouterr().err
    assert not Path("other.png").exists()
