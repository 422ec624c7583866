"""The command: a small study on processes of this machine, stopped and gone on with."""

import csv
import json
import re
import resource
from dataclasses import asdict
from pathlib import Path

import pytest

from tests.conftest import recorded
from vislam.base.errors import Interrupted
from vislam.cli.command import answer
from vislam.cli.console import Terminal
from vislam.comparison import config as configuration
from vislam.study import conduct
from vislam.study.__main__ import main
from vislam.study.cluster import LOST
from vislam.study.connection import WorkersGone
from vislam.study.plan import Plan
from vislam.study.trial import nothing, run_trial

CONFIGS = Path(__file__).parents[2] / "configs"
SMALL = """
name: small
data: {simulation: {frames: 25, tracks_in_view: 20}}
estimators: {dead_reckoning: {}, ekf: {}}
seed: 5
study:
  seeds: 2
  grid: {noise.pixel_sigma_px: [0.5, 1.0]}
"""


@pytest.fixture(autouse=True)
def in_a_folder_of_its_own(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    Path("small.yaml").write_text(SMALL, encoding="utf-8")


@pytest.fixture
def ran(monkeypatch):
    """Run trials in this process, and list them."""
    seen = []

    class Here:
        def connect(self):
            return self

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

    def run_here(client, trials, **how):
        for trial in trials:
            seen.append((trial.point.values, trial.seed))
            yield trial, run_trial(trial.point.tree, trial.seed)

    monkeypatch.setattr("vislam.study.cluster.Cluster.connect", lambda self: Here())
    monkeypatch.setattr(conduct, "run_trials", run_here)
    monkeypatch.setattr(conduct, "watch_at", lambda client: "here")
    return seen


@pytest.fixture
def undrawn(monkeypatch):
    """For tests that do not look at the page, which takes longer than the trials."""
    monkeypatch.setattr(conduct, "write_study_page", lambda page, **parts: page.touch())


def study(*extra):
    return main(["--config", "small.yaml", "--out", "out", *extra])


def only(pattern):
    (path,) = Path("out").glob(pattern)
    return path


def table():
    with only("*/trials.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_a_study_on_two_processes_runs_every_seed_at_every_point(capsys):
    assert study("--workers", "2") == 0
    rows = table()
    assert [(row["noise.pixel_sigma_px"], row["seed"]) for row in rows] == [
        ("0.5", "5"),
        ("0.5", "6"),
        ("1.0", "5"),
        ("1.0", "6"),
    ]
    assert all(row["status"] == "done" and float(row["ekf.ate_rmse.filtered"]) > 0.0 for row in rows)
    document = json.loads(only("*/study.json").read_text(encoding="utf-8"))
    assert document["counts"] == {"done": 4, "failed": 0, "lost": 0}
    assert {"cpu", "code"} <= document["provenance"].keys()
    assert len(list(only("*/trials").glob("*.json"))) == 4
    said = capsys.readouterr()
    assert "4 trials, 0 of them are finished" in said.out
    assert said.err == ""


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_stopped_study_runs_only_what_is_missing(ran):
    assert study() == 0
    whole = table()
    files = [only("*/trials") / f"{row['id']}.json" for row in whole]
    files[1].unlink()
    files[2].write_text(files[2].read_text(encoding="utf-8")[:100], encoding="utf-8")
    ran.clear()
    assert study() == 0
    assert ran == [({"noise.pixel_sigma_px": 0.5}, 6), ({"noise.pixel_sigma_px": 1.0}, 5)]
    errors = [[row["ekf.ate_rmse.filtered"] for row in rows] for rows in (whole, table())]
    assert errors[0] == errors[1]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_more_seeds_go_on_where_the_study_was(ran):
    assert study() == 0
    ran.clear()
    assert study("--set", "study.seeds=3") == 0
    assert [seed for _, seed in ran] == [7, 7]
    assert len(table()) == 6


@pytest.mark.usefixtures("undrawn")
def test_the_longest_drives_run_first_and_the_table_keeps_its_order(ran):
    assert study("--set", "study.grid={data.simulation.frames: [15, 25, 20]}") == 0
    assert [(point["data.simulation.frames"], seed) for point, seed in ran] == [
        *((25, 5), (25, 6), (20, 5), (20, 6), (15, 5), (15, 6))
    ]
    assert [row["data.simulation.frames"] for row in table()] == ["15", "15", "25", "25", "20", "20"]


def test_the_time_left_is_known_of_trials_that_take_minutes(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    now = [0.0]
    with Terminal().bar("trials", 10) as bar:
        bar._drawn.get_time = lambda: now[0]
        for finished in range(4):
            now[0] = 150.0 * finished
            bar.done(finished)
        assert bar._drawn.tasks[0].time_remaining == pytest.approx(7 * 150.0, rel=0.01)


@pytest.mark.usefixtures("undrawn")
def test_only_the_metrics_that_are_asked_for_are_columns(ran):
    assert study("--set", "study.metrics=[ate_rmse]", "--set", "study.seeds=1") == 0
    assert list(table()[0])[-3:] == ["seconds", "dead_reckoning.ate_rmse.filtered", "ekf.ate_rmse.filtered"]


@pytest.mark.usefixtures("undrawn")
def test_a_failing_trial_is_a_row(ran, monkeypatch, capsys):
    def run_here(client, trials, **how):
        for trial in trials:
            tree = trial.point.tree if trial.seed == 5 else {"name": "bad"}
            yield trial, run_trial(tree, trial.seed)

    monkeypatch.setattr(conduct, "run_trials", run_here)
    assert study() == 0
    rows = table()
    assert [row["status"] for row in rows] == ["done", "failed", "done", "failed"]
    assert rows[1]["reason"].startswith("ConfigError: ")
    assert rows[1]["ekf.ate_rmse.filtered"] == ""
    shown = [line.split("│") for line in capsys.readouterr().out.splitlines() if " ekf " in line]
    assert [[cell.strip() for cell in line[3:5]] for line in shown] == [["2", "1"], ["2", "1"]]


def incomplete(name, reason):
    """Trials in which an estimator breaks off, in this process."""

    def run_here(client, trials, **how):
        for trial in trials:
            found = run_trial(trial.point.tree, trial.seed)
            told = reason(trial.seed)
            for one in found["runs"] if name is None else [name]:
                found["runs"][one] = {"complete": False, "error": told}
            scored = {one for one, run in found["runs"].items() if run["complete"]}
            for key in ("metrics", "statistics"):
                found[key] = [one for one in found[key] if scored.issuperset(one["estimator"].split("|"))]
            yield trial, found

    return run_here


@pytest.mark.usefixtures("undrawn")
def test_a_study_whose_trials_all_fail_says_why_and_exits_1(ran, monkeypatch, capsys):
    def run_here(client, trials, **how):
        for trial in trials:
            yield trial, run_trial({"name": "bad" if trial.seed == 5 else 3}, trial.seed)

    monkeypatch.setattr(conduct, "run_trials", run_here)
    assert study() == 1
    said = capsys.readouterr()
    assert "2 of 4 trials: ConfigError: data: " in said.out
    assert "2 of 4 trials: ConfigError: name: " in said.out
    assert "┏" not in said.out
    assert said.err.startswith(
        "vislam: no estimator has finished in any of 4 trials; the first: ConfigError: "
    )
    assert len(said.err.splitlines()) == 1
    assert [row["status"] for row in table()] == ["failed"] * 4
    assert only("*/study.html").is_file()
    # It says so again without running any.
    assert study() == 1
    assert "4 trials, 4 of them are finished" in capsys.readouterr().out


@pytest.mark.usefixtures("undrawn")
def test_a_study_in_which_no_run_finishes_says_why_and_exits_1(ran, monkeypatch, capsys):
    monkeypatch.setattr(conduct, "run_trials", incomplete(None, lambda seed: f"frame {seed}: lost"))
    assert study() == 1
    said = capsys.readouterr()
    # Reasons that differ in the frame are one.
    assert "4 of 4 trials: dead_reckoning: frame 5: lost; ekf: frame 5: lost\n" in said.out
    assert "┏" not in said.out
    assert "no estimator has finished in any of 4 trials" in said.err


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_a_study_in_which_some_runs_finish_counts_the_reasons_of_the_others(ran, monkeypatch, capsys):
    monkeypatch.setattr(
        conduct, "run_trials", incomplete("ekf", lambda seed: "x" * 400 if seed == 5 else "\x1b[2J")
    )
    assert study() == 0
    said = capsys.readouterr()
    assert "┏" in said.out
    assert re.search(r"2 of 4 trials: ekf: x{150,} \[\.\.\.\] x{90,}\n", said.out)
    assert "2 of 4 trials: ekf: \\x1b[2J\n" in said.out
    assert "\x1b" not in said.out


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_no_more_than_a_few_reasons_are_shown(ran, monkeypatch, capsys):
    kinds = iter("abcdefgh")
    monkeypatch.setattr(conduct, "run_trials", incomplete("ekf", lambda seed: next(kinds)))
    assert study("--set", "study.seeds=4") == 0
    told = [line for line in capsys.readouterr().out.splitlines() if " of 8 trials: " in line]
    assert told == [
        *(f"1 of 8 trials: ekf: {kind}" for kind in "abcde"),
        "3 of 8 trials: 3 other reasons",
    ]


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_files_that_are_of_other_trials_are_told_and_run_again(ran, capsys):
    assert study() == 0
    whole = table()
    files = [only("*/trials") / f"{row['id']}.json" for row in whole]
    files[0].write_bytes(files[1].read_bytes())
    found = json.loads(files[2].read_text(encoding="utf-8"))
    files[2].write_text(json.dumps({**found, "values": {"noise.pixel_sigma_px": 0.5}}), encoding="utf-8")
    files[3].write_text("[" * 10_000, encoding="utf-8")
    ran.clear()
    capsys.readouterr()
    assert study() == 0
    assert "3 files of trials are not taken" in capsys.readouterr().out
    assert len(ran) == 3
    assert [row["ekf.ate_rmse.filtered"] for row in table()] == [
        row["ekf.ate_rmse.filtered"] for row in whole
    ]


@pytest.mark.slow
@pytest.mark.parametrize("values", [(1e308,) * 4, (1e308, -1e308, 0.0, 5e-324), (0.0,) * 4, (None,) * 4])
def test_numbers_beyond_all_measure_end_in_a_page(values, ran, capsys):
    assert study() == 0
    for path, value in zip(sorted(only("*/trials").iterdir()), values, strict=True):
        found = json.loads(path.read_text(encoding="utf-8"))
        for metric in found["metrics"]:
            metric["value"] = value
        path.write_text(json.dumps(found), encoding="utf-8")
    only("*/study.html").unlink()
    assert study() == 0
    page = only("*/study.html").read_text(encoding="utf-8")
    assert ("could not be drawn" in page) == (values[0] == values[1] == 1e308)
    assert capsys.readouterr().err == ""


def straight(path, *, step):
    """A file of poses along a line, in KITTI's format."""
    rows = ["1 0 0 0 0 1 0 0 0 0 1 %.1f" % (step * k) for k in range(60)]
    Path(path).write_text("\n".join(rows) + "\n", encoding="utf-8")


@pytest.mark.usefixtures("undrawn")
def test_a_study_runs_again_if_a_file_that_it_reads_has_changed(ran):
    Path("rec.yaml").write_text(
        "name: rec\n"
        "data: {simulation: {frames: 30, tracks_in_view: 15, path: recorded, recorded: "
        '{file: poses.txt, format: kitti, pose_of: left_camera, up: "-y"}}}\n'
        "estimators: {dead_reckoning: {}}\n"
        "study: {seeds: 1}\n",
        encoding="utf-8",
    )
    Path("data").mkdir()
    lengths = []
    for step in (1.0, 2.0, 2.0):
        straight("data/poses.txt", step=step)
        assert main(["--config", "rec.yaml", "--out", "out"]) == 0
        newest = max(Path("out").glob("*/trials.csv"), key=lambda path: path.stat().st_mtime_ns)
        with newest.open(encoding="utf-8", newline="") as file:
            lengths += [float(row["dead_reckoning.path_length.filtered"]) for row in csv.DictReader(file)]
    assert len(ran) == 2
    assert lengths[1] == lengths[2] == pytest.approx(2.0 * lengths[0], rel=0.01)


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_workers_that_are_gone_are_started_again_so_often(ran, monkeypatch, capsys):
    whole, starts = conduct.run_trials, []

    def die(client, trials, **how):
        starts.append(1)
        yield next(whole(client, trials))
        raise WorkersGone("all workers are gone")

    monkeypatch.setattr(conduct, "run_trials", die)
    assert study("--set", "study.seeds=3") == 1
    said = capsys.readouterr()
    assert len(starts) == len(ran) == 4
    for number in (1, 2, 3):
        assert f"all workers are gone; starting others ({number} of 3)\n" in said.out
    assert "all workers are gone; what has finished is kept\n" in said.out
    assert "2 trials were lost with their workers, or there was none left for them" in said.out
    assert "┏" in said.out
    assert len(table()) == 4
    monkeypatch.setattr(conduct, "run_trials", whole)
    assert study("--set", "study.seeds=3") == 0
    assert len(ran) == 6


def test_workers_of_a_scheduler_are_not_ours_to_start(ran, monkeypatch, capsys):
    starts = []

    def die(client, trials, **how):
        starts.append(how["patience"])
        raise WorkersGone("all workers are gone")
        yield

    monkeypatch.setattr(conduct, "run_trials", die)
    assert study("--scheduler", "tls://host:1", "--wait-for-workers", "7") == 1
    assert starts == [7.0]
    assert "all workers are gone; what has finished is kept\n" in capsys.readouterr().out


@pytest.mark.usefixtures("undrawn")
def test_lost_trials_are_run_again(ran, monkeypatch, capsys):
    whole = conduct.run_trials

    def lose(client, trials, **how):
        for trial in trials:
            yield trial, {**nothing(LOST, "KilledWorker"), "seconds": None, "code": "", "inputs": ""}

    monkeypatch.setattr(conduct, "run_trials", lose)
    assert study() == 1
    said = capsys.readouterr().out
    assert said.count("lost, the first: seed 5: KilledWorker\n") == 1
    assert "4 trials were lost with their workers" in said
    assert "┏" not in said
    monkeypatch.setattr(conduct, "run_trials", whole)
    assert study() == 0
    assert len(ran) == 4


def test_an_interrupted_study_keeps_what_is_finished_and_exits_130(ran, monkeypatch, capsys):
    whole = conduct.run_trials

    def interrupted(client, trials, **how):
        yield next(whole(client, trials))
        raise KeyboardInterrupt

    monkeypatch.setattr(conduct, "run_trials", interrupted)
    assert study() == 130
    assert capsys.readouterr().err == "vislam: interrupted\n"
    assert len(list(only("*/trials").glob("*.json"))) == 1
    assert not list(Path("out").glob("*/trials.csv"))


@pytest.mark.parametrize(("cause", "code"), [(Interrupted("SIGTERM"), 130), (None, None)])
def test_a_signal_in_the_middle_of_an_import_is_an_interrupt(cause, code, capsys):
    def imported():
        raise ImportError("initialization failed") from cause

    if code is None:
        with pytest.raises(ImportError, match="initialization failed"):
            answer(imported, verbose=False)
        return
    assert answer(imported, verbose=False) == code
    assert capsys.readouterr().err == "vislam: interrupted\n"


BAD = {
    "no study": (["--set", "study=null"], "study: the config has no such section"),
    "no seeds": (["--set", "study.seeds=0"], "study.seeds: "),
    "empty grid": (["--set", "study.grid={noise.drift_px: []}"], "study.grid.noise.drift_px: "),
    "unknown key": (["--set", "study.seed=3"], "study.seed: unknown key; known are around, defects, grid"),
    "grid and cube": (
        ["--set", "study.latin_hypercube={samples: 2, ranges: {noise.drift_px: [0, 1]}}"],
        "study: one of grid, around, latin_hypercube and defects",
    ),
    "swept key": (["--set", "study.grid={noise.drift: [1]}"], "study: noise.drift: unknown key"),
    "option": (["--set", "study.grid={estimators.ekf.gates: [true]}"], "estimators.ekf.gates: unknown key"),
    "workers": (["--workers", "0"], "--workers must be at least 1"),
    "patience": (["--wait-for-workers", "nan"], "--wait-for-workers must be > 0 and finite [s], got nan"),
    "half of the credentials": (["--tls-ca", "x", "--scheduler", "tls://x:1"], "go together: give all three"),
    "credentials": (["--tls-ca", "x", "--tls-cert", "x", "--tls-key", "x"], "--tls-ca is for --scheduler"),
    "equal numbers": (
        ["--set", "study.grid={noise.pixel_sigma_px: [1, 2, 1.0]}"],
        "got the same one twice (noise.pixel_sigma_px 1 and noise.pixel_sigma_px 1.0); leave one out",
    ),
    "a date": (
        ["--set", "study.grid={estimators.ekf.gate: [2026-01-01]}"],
        "ekf.gate: Input should be a valid boolean",
    ),
    "a seed beyond all": (["--seed", "9223372036854775807"], "seed: must be below 9223372036854775808"),
    "place": (["--out", "small.yaml"], "cannot be written ("),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input_gets_one_line_and_2(case, ran, capsys):
    extra, message = BAD[case]
    assert study(*extra) == 2
    said = capsys.readouterr()
    assert message in said.err
    assert len(said.err.splitlines()) == 1
    assert ran == []


def test_a_full_disk_is_one_line_and_2(ran, monkeypatch, capsys):
    def full(self, *args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_text", full)
    assert study() == 2
    said = capsys.readouterr().err
    assert "cannot be written (No space left on device)" in said
    assert len(said.splitlines()) == 1
    assert list(only("*/trials").iterdir()) == []


@pytest.mark.slow
def test_a_page_that_does_not_fit_is_one_line_and_2_and_comes_with_the_next_start(ran, capsys, monkeypatch):
    monkeypatch.setattr("vislam.study.folder.has_parquet", lambda: False)
    assert study() == 0
    only("*/study.html").unlink()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # The trials and their table are smaller, the page is not.
    resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, hard))
    try:
        assert study() == 2
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    said = capsys.readouterr().err
    assert "study.html: cannot be written (File too large)" in said
    assert len(said.splitlines()) == 1
    assert sorted(path.name for path in only("small-*").iterdir()) == ["study.json", "trials", "trials.csv"]
    assert study() == 0
    assert len(ran) == 4
    assert only("*/study.html").stat().st_size > 50_000


SIMULATED = [CONFIGS / f"{name}.yaml" for name in ("monte_carlo", "consistency", "held_out")]


@pytest.mark.parametrize("path", [*sorted(CONFIGS.glob("sweep_*.yaml")), *SIMULATED])
def test_the_studies_that_come_along_can_be_planned(path):
    from vislam.comparison import config as configuration

    plan = Plan.of(configuration.load(path))
    assert len(plan.points) * plan.study.seeds == len({trial.id for trial in plan.trials()})
    assert len({point.digest for point in plan.points}) == len(plan.points)


@pytest.mark.slow
def test_a_recording_has_no_seeds(ran, capsys):
    recorded("03.npz")
    assert study("--set", "data.file=03.npz") == 2
    assert "study.seeds: 03.npz is the same with every seed" in capsys.readouterr().err
    assert ran == []


def test_an_ablation_runs_each_case_once_and_leaves_its_config(ran, capsys):
    defects = {"late": {"noise.pixel_sigma_px": 5.0}, "wild": {"estimators.ekf.gate": False}}
    assert study("--set", "study.grid={}", "--set", f"study.defects={defects}", "--set", "study.seeds=1") == 0
    assert [values["case"] for values, _ in ran] == ["all defects", "only wild", "no defect", "only late"]
    shown = capsys.readouterr().out
    assert "2. wild" in shown
    page = only("*/study.html").read_text(encoding="utf-8")
    assert "What each defect costs" in page
    assert "SIMULATED" in page
    wild = configuration.load(only("*/cases/*only_wild.yaml"))
    assert wild.estimators["ekf"] == {"gate": False}
    assert wild.noise.pixel_sigma_px != 5.0
    # The case is the same run on its own.
    found = run_trial(ran_tree(wild), seed=5)
    saved = json.loads(only(f"*/trials/{trial_of('only wild')}.json").read_text(encoding="utf-8"))
    assert error_of(found) == error_of(saved)


def trial_of(case):
    return next(row["id"] for row in table() if row["case"] == case)


def ran_tree(config):
    return json.loads(json.dumps(asdict(config)))


def error_of(result):
    return next(m["value"] for m in result["metrics"] if m["estimator"] == "ekf" and m["key"] == "ate_rmse")


def test_a_study_of_a_missing_recording_is_of_its_substitute_and_says_so(ran, capsys):
    assert study("--set", "data.file=nowhere.npz") == 0
    assert len(ran) == 4
    assert "[SIMULATED]" in capsys.readouterr().out
    assert "SIMULATED: synthetic substitute for nowhere.npz" in only("*/study.html").read_text(
        encoding="utf-8"
    )
    assert json.loads(only("*/study.json").read_text(encoding="utf-8"))["config"]["data"]["file"] is None


@pytest.mark.slow
def test_an_ablation_can_be_of_a_recording(ran, monkeypatch, capsys):
    monkeypatch.setenv("VISLAM_DATA", str(recorded("03.npz").parent))
    Path("small.yaml").write_text(
        "name: recorded\n"
        "data:\n"
        "  file: 03.npz\n"
        "  reference: {file: 03_positions_xy.txt, format: planar_xy, name: poses, limits: planar}\n"
        "held_out: {share: 0.0}\n"
        "estimators: {dead_reckoning: {}}\n"
        "gates_from: null\n"
        "study: {seeds: 1, defects: {first: {estimators.dead_reckoning.integration: first}}}\n"
    )
    assert study() == 0
    assert "[SIMULATED]" not in capsys.readouterr().out
    assert [row["case"] for row in table()] == ["all defects", "no defect"]
    errors = [float(row["dead_reckoning.ate_planar_rmse.filtered"]) for row in table()]
    assert errors[0] != errors[1]
    assert "RECORDED: every trial is of 03.npz; reference poses: planar" in only("*/study.html").read_text()
    document = json.loads(only("*/study.json").read_text(encoding="utf-8"))
    plan = Plan.of(configuration.load(Path("small.yaml")))
    assert plan.data
    assert document["counts"]["done"] == 2
