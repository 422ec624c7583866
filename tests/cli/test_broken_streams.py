"""Commands whose output nobody reads: neither the work nor the exit code depends on it."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
TINY = str(ROOT / "configs" / "tiny.yaml")
COMPARE = ["compare", "--config", TINY, "--estimators", "dead_reckoning", "--no-report"]
COMPARE += ["--set", "data.simulation.frames=12"]
BREAKS = {
    "a reader that reads nothing": '"$@" | true; exit ${PIPESTATUS[0]}',
    "a reader of one line": '"$@" | head -1; exit ${PIPESTATUS[0]}',
    "a full disk": '"$@" > /dev/full',
    "full disks": '"$@" > /dev/full 2> /dev/full',
    "closed": 'exec "$@" >&-',
    "all closed": 'exec "$@" <&- >&- 2>&-',
    "closed for errors": 'exec "$@" 2>&-',
}


def ended(how, command, folder):
    """Exit code of a command whose streams break."""
    environment = {**os.environ, "MPLBACKEND": "agg", "PYTHONPATH": str(ROOT)}
    shell = ["bash", "-c", BREAKS[how], "bash", sys.executable, "-m", f"vislam.{command[0]}", *command[1:]]
    done = subprocess.run(shell, cwd=folder, capture_output=True, env=environment, text=True, check=False)
    assert "Traceback" not in done.stderr
    assert "Exception ignored" not in done.stderr
    return done.returncode


@pytest.mark.slow
@pytest.mark.parametrize("how", sorted(BREAKS))
def test_a_comparison_does_all_its_work(how, tmp_path):
    checks = "checks=[{estimator: dead_reckoning, metric: path_length, at_most: 0}]"
    command = [*COMPARE, "--set", checks, "--out", "out", "--junit", "j.xml"]
    assert ended(how, command, tmp_path) == 3
    assert 'failures="1"' in (tmp_path / "j.xml").read_text()
    (metrics,) = tmp_path.glob("out/*/metrics.json")
    assert json.loads(metrics.read_text())["runs"]["dead_reckoning"]["complete"]


@pytest.mark.slow
@pytest.mark.parametrize("how", ["a reader that reads nothing", "full disks", "all closed"])
@pytest.mark.parametrize(
    ("command", "code"),
    [
        (["fetch", "--list"], 0),
        (["fetch"], 2),
        (["compare", "--help"], 0),
        (["compare", "--config", TINY, "--dump-config"], 0),
        (["compare", "--nothing"], 2),
        (["simulate", "--config", "nowhere.yaml", "--out", "a.npz"], 2),
        (["cli.table", "nowhere"], 2),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, list) else "",
)
def test_a_command_ends_as_it_would(how, command, code, tmp_path):
    assert ended(how, command, tmp_path) == code
