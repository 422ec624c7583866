"""Nothing that was computed is lost: finished runs are kept, scored, and gone on with."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import chdir
from pathlib import Path

import numpy as np
import pytest

from tests.records import altered
from vislam import compare
from vislam.base.errors import Interrupted
from vislam.core.run import Run
from vislam.estimators import loop

ROOT = Path(__file__).parents[2]
CONFIG = """
name: kept
data: {simulation: {frames: 12, tracks_in_view: 20}}
common_set_from: []
gates_from: ekf
estimators: {dead_reckoning: {}, ekf: {}, eks: {}, stereo_vo: {}}
seed: 1
"""


@pytest.fixture
def config(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("kept.yaml").write_text(CONFIG, encoding="utf-8")
    return "kept.yaml"


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """The folder of a comparison that has finished, which nobody may change."""
    with chdir(tmp_path_factory.mktemp("finished")):
        Path("kept.yaml").write_text(CONFIG, encoding="utf-8")
        code, folder = start("kept.yaml")
        assert code == 0
        return folder.resolve()


@pytest.fixture
def folder(config, finished):
    """A copy of it, in the current folder."""
    return Path(shutil.copytree(finished, Path("results") / finished.name))


def start(config, *options):
    code = compare.main(["--config", config, "--no-report", *options])
    (folder,) = Path("results").iterdir()
    return code, folder


def document(folder):
    return json.loads((folder / "metrics.json").read_text(encoding="utf-8"))


def numbers(folder):
    """Metrics but for time and memory."""
    timed = ("_ms", "_time_s", "_rss_mb")
    found = {(m["estimator"], m["key"]): m["value"] for m in document(folder)["metrics"]}
    return {key: value for key, value in found.items() if not key[1].endswith(timed)}


@pytest.fixture
def calls(monkeypatch):
    """Names of the runs that are really run."""
    made = []
    real = loop.run

    def counted(*args, name, **options):
        made.append(name)
        return real(*args, name=name, **options)

    monkeypatch.setattr(loop, "run", counted)
    return made


def test_a_second_start_runs_nothing_and_says_so(config, calls, capsys):
    _, folder = start(config)
    assert calls == ["dead_reckoning", "ekf", "eks", "stereo_vo"]
    first = (folder / "metrics.json").read_bytes()
    assert "earlier start" not in capsys.readouterr().out
    calls.clear()
    assert start(config) == (0, folder)
    assert calls == []
    assert "kept from an earlier start (--fresh runs them again): dead_reckoning, ekf, eks, stereo_vo" in (
        capsys.readouterr().out
    )
    assert (folder / "metrics.json").read_bytes() == first
    assert start(config, "--fresh") == (0, folder)
    assert calls == ["dead_reckoning", "ekf", "eks", "stereo_vo"]


@pytest.mark.parametrize("damage", ["missing", "cut", "incomplete", "other identity", "other name", "empty"])
def test_only_what_is_whole_and_of_the_same_identity_is_gone_on_with(config, folder, calls, damage):
    whole = numbers(folder)
    path = folder / "runs" / "eks.npz"
    run = Run.load(path)
    if damage == "missing":
        path.unlink()
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:-200])
    elif damage == "empty":
        path.write_bytes(b"")
    elif damage == "other name":
        path.write_bytes((folder / "runs" / "ekf.npz").read_bytes())
    else:
        change = {"error": "frame 3: lost"} if damage == "incomplete" else {"identity": "0" * 16}
        altered(run, **change).save(path)
    assert start(config)[0] == 0
    assert calls == ["eks"]
    assert numbers(folder) == whole


def test_another_gate_upstream_runs_what_it_decides_again(config, folder, calls):
    path = folder / "runs" / "ekf.npz"
    run = Run.load(path)
    gated = run.gated.copy()
    gated[np.flatnonzero(~gated)[:3]] = True
    run.__class__(**{**vars(run), "gated": gated}).save(path)
    assert start(config)[0] == 0
    assert calls == ["eks", "stereo_vo"]


@pytest.mark.parametrize("failing", ["dead_reckoning", "ekf", "eks", "stereo_vo"])
def test_one_that_fails_leaves_the_others_whole(folder, calls, failing, monkeypatch, capsys):
    whole = numbers(folder)
    real = loop.checked_step

    def broken(step, frame, sizes):
        if calls[-1] == failing and frame.k == 5:
            sys.exit(0)
        return real(step, frame, sizes)

    monkeypatch.setattr(loop, "checked_step", broken)
    code, _ = start("kept.yaml", "--fresh", "--junit", "j.xml", "--verbose")
    assert code == 1
    runs = document(folder)["runs"]
    assert [name for name, run in runs.items() if not run["complete"]] == [failing]
    assert runs[failing]["error"] == "frame 5: SystemExit: 0"
    assert runs[failing]["frames"] == 5
    kept = {key: value for key, value in numbers(folder).items() if failing not in key[0]}
    # What is rejected by the gate of a run that fails is rejected up to there only.
    if failing != "ekf":
        assert kept == {key: value for key, value in whole.items() if failing not in key[0]}
    assert Path("j.xml").read_text().count("<error ") == 1
    assert f"{failing} is incomplete: frame 5: SystemExit: 0" in capsys.readouterr().out
    assert "sys.exit(0)" in Run.load(folder / "runs" / f"{failing}.npz").log.traceback
    monkeypatch.setattr(loop, "checked_step", real)
    assert start("kept.yaml")[0] == 0
    assert numbers(folder) == whole


def test_an_interrupt_keeps_and_scores_what_had_finished(config, calls, monkeypatch, capsys):
    real = loop.checked_step

    def interrupted(step, frame, sizes):
        if calls[-1] == "eks" and frame.k == 5:
            raise Interrupted
        return real(step, frame, sizes)

    monkeypatch.setattr(loop, "checked_step", interrupted)
    code, folder = start(config)
    assert code == 130
    runs = document(folder)["runs"]
    assert {name: (run["complete"], run["frames"]) for name, run in runs.items()} == {
        "dead_reckoning": (True, 12),
        "ekf": (True, 12),
        "eks": (False, 5),
        "stereo_vo": (False, 0),
    }
    assert runs["eks"]["error"] == "frame 5: interrupted"
    assert runs["stereo_vo"]["error"] == "interrupted"
    assert ("ekf", "ate_rmse") in numbers(folder)
    assert "eks is incomplete: frame 5: interrupted" in capsys.readouterr().out
    monkeypatch.setattr(loop, "checked_step", real)
    calls.clear()
    assert start(config)[0] == 0
    assert calls == ["eks", "stereo_vo"]


def test_passes_that_select_observations_are_kept_too(config, calls):
    text = CONFIG.replace("common_set_from: []\ngates_from: ekf\n", "common_set_from: [ekf, eks]\n")
    Path(config).write_text(text, encoding="utf-8")
    _, folder = start(config)
    assert calls[:2] == ["ekf", "eks"]
    whole = numbers(folder)
    (folder / "runs" / "eks.npz").unlink()
    calls.clear()
    assert start(config)[0] == 0
    assert calls == ["eks"]
    assert numbers(folder) == whole


def test_an_estimator_cannot_change_the_problem_of_the_next(config, folder, monkeypatch):
    whole = numbers(folder)
    from vislam_baselines import dead_reckoning

    real = dead_reckoning.build

    def spoils(problem, options):
        built = real(problem, options)
        for array in (
            problem.bias_sigma,
            problem.first_pose_sigma,
            problem.noise.twist,
            problem.rig.imu_T_cam,
        ):
            array[...] = 7.0
        return built

    monkeypatch.setattr(dead_reckoning, "build", spoils)
    assert start(config, "--fresh")[0] == 0
    kept = {key: value for key, value in numbers(folder).items() if "dead_reckoning" not in key[0]}
    assert kept == {key: value for key, value in whole.items() if "dead_reckoning" not in key[0]}


@pytest.mark.slow
def test_killed_at_any_moment_it_keeps_what_had_finished_and_goes_on(tmp_path):
    text = CONFIG.replace("frames: 12", "frames: 60").replace("stereo_vo", "isam2: {}, stereo_vo")
    (tmp_path / "kept.yaml").write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "vislam.compare", "--config", "kept.yaml", "--no-report"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}

    def begin(*options):
        return subprocess.Popen(
            [*command, *options],
            cwd=tmp_path,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    began = time.monotonic()
    whole = begin()
    whole.communicate()
    took = time.monotonic() - began
    assert whole.returncode == 0
    (folder,) = (tmp_path / "results").iterdir()
    wanted = numbers(folder)
    names = list(document(folder)["runs"])
    rng = np.random.default_rng(20261129)
    for number, share in enumerate(rng.uniform(0.2, 1.0, size=6)):
        killed = begin("--fresh")
        time.sleep(share * took)
        # Every other time the polite way, which ends with what there is.
        kind = signal.SIGTERM if number % 2 else signal.SIGKILL
        killed.send_signal(kind)
        killed.communicate()
        assert killed.returncode in (0, -kind, 130)
        finished = {path.stem: Run.load(path) for path in (folder / "runs").glob("*.npz")}
        complete = [name for name in names if name in finished and finished[name].complete]
        again = begin()
        shown, said = again.communicate()
        assert (again.returncode, said) == (0, "")
        line = next((line for line in shown.splitlines() if "earlier start" in line), ": ")
        assert line.partition(": ")[2].split(", ") == (complete or [""])
        assert numbers(folder) == wanted
        assert {path.name for path in (folder / "runs").iterdir()} == {f"{name}.npz" for name in names}
