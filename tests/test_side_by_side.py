"""Estimators of a comparison in processes of their own: the results of one after the other, and as robust."""

import json
import os
import signal
import time
import uuid
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np
import pytest

from tests.calibration.test_workers import MARK, marked, spawned, workers
from tests.study.processes import environment, python, until
from vislam import compare
from vislam.base.errors import Interrupted, LostError
from vislam.base.files import save_archive
from vislam.base.progress import Silent
from vislam.base.workers import advance
from vislam.comparison.compare import prepare
from vislam.comparison.running import _groups
from vislam.comparison.side_by_side import SideBySide
from vislam.core.archive import _taken_apart
from vislam.core.run import Run
from vislam.estimators.ekf.family import build as build_ekf

ESTIMATORS = {"dead_reckoning": {}, "ekf": {}, "eks": {}, "isam2": {}}
CONFIG = """
name: beside
data: {simulation: {frames: FRAMES, tracks_in_view: 20}}
common_set_from: []
estimators: {dead_reckoning: {}, ekf: {}, eks: {}, stereo_vo: {}}
seed: 1
"""


class _Wrapped:
    """An estimator that does something before each of its steps."""

    def __init__(self, problem, before):
        self._inner, self._before = build_ekf(problem, {}), before

    def process(self, frame):
        self._before(frame.k)
        return self._inner.process(frame)

    def finalize(self):
        return self._inner.finalize()


def build_killed(problem):
    return _Wrapped(problem, lambda k: os.kill(os.getpid(), signal.SIGKILL) if k == 3 else None)


def build_slow(problem):
    return _Wrapped(problem, lambda k: time.sleep(0.2))


def bits(run):
    """All of a run but time and memory, as plain data and bytes."""
    arrays = {}
    plain = _taken_apart(
        replace(run, cost=replace(run.cost, total_time=0.0, peak_rss=0, beside=0)), arrays, at=""
    )
    return plain, {
        key: (array.dtype, array.shape, array.tobytes()) for key, array in arrays.items() if "time" not in key
    }


def test_who_waits_for_whom():
    names = ("a", "b", "c", "d")
    assert _groups(names, None) == [names]
    assert _groups(names, "b") == [("a", "b"), ("c", "d")]
    assert _groups(names, "d") == [names, ()]


def test_the_marks_of_what_ran_beside_others(short_config, short):
    config = replace(short_config, estimators={"dead_reckoning": {}, "ekf": {}})
    results = prepare(config, short, Silent()).run()
    assert results.timed_line() == ""
    run = results.runs["ekf"]
    results.runs["ekf"] = replace(run, cost=replace(run.cost, beside=2))
    assert results.timed_line().startswith("times and memory of ekf are of processes beside up to 2 others; ")


def test_a_run_of_an_older_version_ran_alone(short_config, short, tmp_path):
    run = (
        prepare(replace(short_config, estimators={"dead_reckoning": {}}), short, Silent())
        .run()
        .runs["dead_reckoning"]
    )
    arrays = {}
    plain = _taken_apart(replace(run, cost=replace(run.cost, beside=3)), arrays, at="")
    save_archive(tmp_path / "new.npz", plain, arrays)
    assert Run.load(tmp_path / "new.npz").cost.beside == 3
    del plain["cost"]["beside"]
    save_archive(tmp_path / "old.npz", plain, arrays)
    assert Run.load(tmp_path / "old.npz").cost.beside == 0


@pytest.mark.slow
@pytest.mark.parametrize("values", [{}, {"common_set_from": (), "gates_from": "ekf"}])
def test_the_results_are_those_of_one_after_the_other(values, short_config, short):
    prepared = prepare(replace(short_config, estimators=ESTIMATORS, **values), short, Silent())
    one, other = prepared.run().runs, prepare(prepared.config, short, Silent()).run(at_a_time=3).runs
    assert list(one) == list(other) == list(ESTIMATORS)
    assert max(run.cost.beside for run in other.values()) > 0
    for name, run in one.items():
        assert run.complete
        assert bits(run) == bits(other[name])


@pytest.mark.slow
def test_one_that_kills_its_process_is_given_up_and_takes_no_other_with_it(short_config, short):
    killed = {"killed": {"estimator": "tests.test_side_by_side:build_killed"}}
    config = replace(short_config, estimators={"dead_reckoning": {}, **killed, "ekf": {}, "eks": {}})
    found = prepare(config, short, Silent()).run(at_a_time=2).runs
    assert found["killed"].log.error == "its process was lost whenever it ran, killed or out of memory"
    assert [name for name, run in found.items() if not run.complete] == ["killed"]
    assert list(found) == ["dead_reckoning", "killed", "ekf", "eks"]


@pytest.mark.slow
def test_what_runs_at_an_interrupt_keeps_what_it_had_done(short_config, short):
    slow = {"slow": {"estimator": "tests.test_side_by_side:build_slow"}}
    prepared = prepare(replace(short_config, estimators={**slow, "ekf": {}}), short, Silent())
    everything = np.ones(prepared.runner.sequence.observations, bool)
    jobs = [prepared._job(name, everything) for name in ("slow", "ekf")]
    with SideBySide(jobs, 2, Silent()) as several:
        ended = next(several.finished())
        (stopped,) = several.stopped()
    assert (ended.name, ended.complete) == ("ekf", True)
    assert stopped.name == "slow"
    assert stopped.log.error.endswith(": interrupted")


def twice(number):
    return 2 * number


def deadly(number):
    if number in (1, 4):
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def counting(number):
    with suppress(Interrupted):
        for count in range(10**6):
            advance(count)
            time.sleep(0.01)
    return number


@pytest.mark.slow
def test_jobs_are_answered_as_they_end_whatever_some_do_to_their_process():
    said = []
    with workers(said) as found:
        assert sorted(found.each(twice, range(5))) == [(number, 2 * number) for number in range(5)]
        assert list(found.each(twice, [])) == []
        answers = dict(found.each(deadly, range(6)))
        assert {number for number, answer in answers.items() if isinstance(answer, LostError)} == {1, 4}
        assert all(answers[number] == number for number in (0, 2, 3, 5))
        assert found.map(twice, [4]) == [8]
    assert set(said) == {"a worker process was lost; what ran is done again, one at a time"}


@pytest.mark.slow
def test_how_far_they_are_is_seen_and_they_end_when_told():
    seen = {}

    def on_tick(counts):
        seen.update(counts)
        if len(seen) == 2 and min(seen.values()) > 0:
            raise Interrupted

    with workers() as found:
        with pytest.raises(Interrupted):
            list(found.each(counting, [7, 8], on_tick=on_tick))
        assert sorted(found.stopped()) == [(0, 7), (1, 8)]


# The command as a process ----------------------------------------------------------------------------------


@contextmanager
def command(folder, *, frames, jobs=2):
    (folder / "beside.yaml").write_text(CONFIG.replace("FRAMES", str(frames)), encoding="utf-8")
    mark = uuid.uuid4().hex
    arguments = ("-m", "vislam.compare", "--config", "beside.yaml", "--no-report", "--jobs", jobs)
    with python(*arguments, env={**environment(), MARK: mark}, cwd=folder, start_new_session=True) as process:
        yield process, mark


def kept(folder):
    return {path.stem: Run.load(path) for path in folder.glob("results/*/runs/*.npz")}


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_command_keeps_scores_and_goes_on(number, tmp_path):
    with command(tmp_path, frames=400) as (process, mark):
        until(lambda: len(kept(tmp_path)) > 0)
        os.killpg(process.pid, number)
        _, err = process.communicate()
        assert (process.returncode, err) == (130, "")
        until(lambda: not marked(mark))
    (folder,) = (tmp_path / "results").iterdir()
    runs = json.loads((folder / "metrics.json").read_text())["runs"]
    begun = [run for run in runs.values() if not run["complete"] and run["frames"]]
    assert begun
    assert all(run["error"].endswith("interrupted") for run in runs.values() if not run["complete"])
    before = {name: run for name, run in kept(tmp_path).items() if run.complete}
    os.chdir(tmp_path)
    assert compare.main(["--config", "beside.yaml", "--no-report", "--jobs", "2"]) == 0
    for name, run in before.items():
        assert bits(run) == bits(kept(tmp_path)[name])


@pytest.mark.slow
def test_a_killed_command_leaves_no_process_and_what_had_ended(tmp_path):
    with command(tmp_path, frames=400) as (process, mark):
        until(lambda: len(kept(tmp_path)) > 0)
        process.kill()
        process.wait()
        until(lambda: not marked(mark))
    assert any(run.complete for run in kept(tmp_path).values())


@pytest.mark.slow
def test_a_worker_that_is_killed_from_outside_is_replaced(tmp_path):
    with command(tmp_path, frames=200) as (process, mark):
        until(lambda: len(spawned(mark)) == 2)
        os.kill(spawned(mark)[0], signal.SIGKILL)
        out, err = process.communicate()
        assert (process.returncode, err) == (0, "")
        assert "a worker process was lost; what ran is done again, one at a time" in out


def test_fewer_than_one_at_a_time_is_refused(tmp_path, capsys):
    path = tmp_path / "beside.yaml"
    path.write_text(CONFIG.replace("FRAMES", "12"), encoding="utf-8")
    assert compare.main(["--config", str(path), "--jobs", "0"]) == 2
    assert (
        "--jobs is the number of estimators that run at the same time, 1 or more; got 0"
        in capsys.readouterr().err
    )


def test_without_another_to_run_beside_it_runs_here(short_config, short, monkeypatch):
    monkeypatch.setattr("vislam.comparison.running.SideBySide", None)
    config = replace(short_config, estimators={"dead_reckoning": {}})
    assert prepare(config, short, Silent()).run(at_a_time=4).runs["dead_reckoning"].cost.beside == 0
