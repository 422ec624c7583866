"""What a command says while it works, and of what was there before."""

import re
import subprocess
import sys

import pytest

from vislam.cli import console
from vislam.cli.console import Terminal
from vislam.comparison.compare import told_of_rerun
from vislam.comparison.provenance import command_line, provenance


def test_where_there_is_no_terminal_a_line_now_and_then_stands_for_the_bar(monkeypatch, capsys):
    times = iter([0.0, 1.0, 9.0, 11.0, 12.0, 25.0])
    monkeypatch.setattr(console.time, "monotonic", lambda: next(times))
    with Terminal().bar("ekf", 100) as bar:
        for count in (5, 40, 50, 60, 90):
            bar.done(count)
    assert capsys.readouterr().out.splitlines() == [
        "ekf: 50 of 100 after 11 s, 11 s left",
        "ekf: 90 of 100 after 25 s, 3 s left",
    ]


def test_the_first_line_comes_before_the_config_is_read(tmp_path):
    """Whatever follows: here nothing does, as there is no such key."""
    (tmp_path / "c.yaml").write_text("name: c\nnothing: 1\n")
    text = "import sys; from vislam.cli.compare import main; code = main(['c.yaml']); "
    text += "print(code, 'matplotlib' in sys.modules, 'gtsam' in sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", text], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.stdout.splitlines() == ["vislam compare c.yaml", "2 False False"], done.stderr


def test_a_rerun_says_what_became_of_what_was_there():
    assert told_of_rerun([], ["ekf", "isam2"], again=False) == []
    kept, now = told_of_rerun(["ekf"], ["ekf", "isam2"], again=False)
    assert kept.endswith("again): ekf")
    assert now == "computed now: isam2"
    assert told_of_rerun(["ekf"], ["ekf"], again=True)[1:] == [
        "overwritten: metrics.json, and the page with its figures"
    ]
    assert told_of_rerun([], ["ekf"], again=True)[0] == "computed again: ekf"


def test_provenance_has_command_commit_and_cores():
    found = provenance()
    assert {"command", "commit", "cores", "cpu", "date", "code", "gtsam"} <= found.keys()
    used, of = map(int, found["cores"].split(" of "))
    assert 1 <= used <= of
    assert command_line(["/usr/bin/python3", "/opt/bin/vislam", "compare", "a b.yaml"]) == (
        "vislam compare 'a b.yaml'"
    )
    assert command_line(["/usr/bin/python3", "-m", "vislam", "compare"]) == "python3 -m vislam compare"
    assert command_line([]) == "''"


STUDY = ["point", "estimator", "trials", "failed", "ATE [m]", "95 % interval", "NEES", "95 % interval"]
CELLS = ["noise.pixel_sigma_px 0.125", "ekf_invariant", "20", "0", "12.345", "10.123 to 14.456"]
CELLS += ["1.234", "1.000 to 2.000"]


@pytest.mark.parametrize("columns", [70, 80, 120])
def test_no_cell_is_cut_off_whatever_the_width(columns, monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm")
    Terminal().rows(STUDY, [CELLS], title="a study")
    lines = re.sub(r"\x1b\[[\d;]*m", "", capsys.readouterr().out).splitlines()
    assert not any("…" in line for line in lines)
    assert max(map(len, lines)) <= columns
    for cell in CELLS:
        assert any(cell in line for line in lines), cell
    told = [line for line in lines if "ekf_invariant" in line]
    assert all("noise.pixel_sigma_px" in line for line in told)


def test_a_table_in_a_file_is_as_wide_as_it_needs(capsys):
    Terminal().rows(STUDY, [[f"{cell} and so on" for cell in CELLS]], title="a study")
    out = capsys.readouterr().out
    assert all(f"{cell} and so on" in out for cell in CELLS)
