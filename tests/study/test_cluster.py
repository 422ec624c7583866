"""Trials on workers: few at a time, and what becomes of a worker's death or of other code."""

import itertools
import time
from importlib.machinery import ModuleSpec
from types import SimpleNamespace

import pytest
from distributed import Client, Future

from vislam.base.errors import ConfigError, DataError
from vislam.comparison.identity import code_digest
from vislam.study import cluster
from vislam.study.cluster import LOST, Cluster, run_trials
from vislam.study.connection import Tls, WorkersGone
from vislam.study.points import Point, all_trials

WORKERS = 2
SETS = itertools.count()


@pytest.fixture(scope="module")
def client():
    """Threads of this process: as good as any worker, and quick to start."""
    with Client(
        processes=False, n_workers=WORKERS, threads_per_worker=1, dashboard_address=None, protocol="inproc://"
    ) as client:
        yield client


def trials(number):
    """Trials that no other test has: a scheduler knows a trial by its id."""
    return all_trials([Point({}, {})], seeds=range(number), code=str(next(SETS)))


def work(tree, seed):
    return {"status": "done", "seed": seed, "code": code_digest(), "inputs": ""}


def test_each_trial_comes_back_once_and_few_are_held_at_a_time(client):
    taken, held = itertools.count(), []

    def counted():
        for trial in trials(60):
            next(taken)
            held.append(len(client.futures))
            yield trial

    found = [(trial.seed, result["seed"]) for trial, result in run_trials(client, counted(), work=work)]
    assert sorted(found) == [(seed, seed) for seed in range(60)]
    # Four for each worker, and the one that has just been taken.
    assert max(held) <= 4 * WORKERS
    assert next(taken) == 60


def short(tree, seed):
    return {**work(tree, seed), "seconds": 0.001}


def test_short_trials_go_several_to_a_task(client, monkeypatch):
    tasks = []
    submit = client.submit
    monkeypatch.setattr(
        client, "submit", lambda *given, **how: tasks.append(len(given[2])) or submit(*given, **how)
    )
    found = sorted(result["seed"] for _, result in run_trials(client, trials(200), work=short))
    assert found == list(range(200))
    assert tasks[:8] == [1] * 8
    assert max(tasks) == 16
    assert sum(tasks) == 200


def test_of_several_in_a_task_only_the_one_at_fault_is_lost(client):
    def one_broken(tree, seed):
        if seed == 77:
            raise MemoryError("out of memory")
        return short(tree, seed)

    found = {
        trial.seed: result["status"] for trial, result in run_trials(client, trials(100), work=one_broken)
    }
    assert found == {seed: LOST if seed == 77 else "done" for seed in range(100)}


def test_long_trials_go_one_to_a_task():
    pace = cluster._Pace()
    for seconds, trials_of_task in ((0.001, 16), (0.1, 5), (0.3, 1), (90.0, 1), (0.02, 16)):
        pace.take([{"seconds": seconds}, {"seconds": 0.0}])
        assert pace.trials == trials_of_task
    pace.take([])
    pace.take([{"seconds": None}])
    assert pace.trials == 16


def test_trials_are_drawn_only_as_others_finish(client):
    drawn = []

    def told():
        for trial in trials(60):
            drawn.append(trial.seed)
            yield trial

    running = run_trials(client, told(), work=work)
    next(running)
    assert len(drawn) <= 4 * WORKERS + 1
    running.close()


def test_workers_that_come_later_get_trials_too(client, monkeypatch):
    workers, held = {"a": 1}, []
    while client.futures:
        # Of the test before.
        time.sleep(0.01)
    monkeypatch.setattr(client, "nthreads", lambda: workers)
    for place, _ in enumerate(run_trials(client, trials(60), work=work)):
        held.append(len(client.futures))
        if place == 9:
            workers["b"] = 1
    # Four for each, and the one that has just come back.
    assert max(held[:10]) <= 5
    assert max(held[11:]) in (8, 9)


def test_a_trial_that_its_worker_cannot_return_is_lost_and_says_why(client):
    def broken(tree, seed):
        raise MemoryError("out of memory")

    ((_, result),) = run_trials(client, trials(1), work=broken)
    assert result["status"] == LOST
    assert result["reason"] == "MemoryError: out of memory"


def test_a_worker_of_other_code_ends_the_study(client):
    def old(tree, seed):
        return {**work(tree, seed), "code": "0123456789"}

    with pytest.raises(ConfigError, match="a worker has vislam of code 0123456789, here it is"):
        list(run_trials(client, trials(1), work=old))


def test_a_worker_that_read_other_files_ends_the_study(client):
    def other(tree, seed):
        return {**work(tree, seed), "inputs": "0123456789"}

    with pytest.raises(ConfigError, match="a worker has read other files"):
        list(run_trials(client, trials(1), work=other))


def test_trials_that_nobody_takes_end_with_a_line(client, monkeypatch):
    """Workers that are there, and then are not for longer than one is willing to wait."""
    told, now = [], itertools.count()

    def never(tree, seed):
        time.sleep(3.0)
        return work(tree, seed)

    monkeypatch.setattr(client, "cluster", None)
    monkeypatch.setattr(client, "nthreads", dict)
    clock = SimpleNamespace(sleep=time.sleep, monotonic=lambda: float(next(now)))
    monkeypatch.setattr(cluster, "time", clock)
    with pytest.raises(WorkersGone, match="all workers are gone, for 40 s now"):
        list(run_trials(client, trials(1), work=never, patience=40.0, say=told.append))
    assert told == ["all workers are gone; waiting 40 s for others"]


def test_workers_that_come_back_in_time_are_waited_for(client, monkeypatch):
    told, now, looked = [], itertools.count(), itertools.count()

    def slow(tree, seed):
        time.sleep(0.5)
        return work(tree, seed)

    monkeypatch.setattr(client, "cluster", None)
    monkeypatch.setattr(client, "nthreads", lambda: {} if next(looked) % 10 else {"a": 1})
    clock = SimpleNamespace(sleep=time.sleep, monotonic=lambda: float(next(now)))
    monkeypatch.setattr(cluster, "time", clock)
    assert len(list(run_trials(client, trials(1), work=slow, patience=12.0, say=told.append))) == 1
    assert set(told) == {"all workers are gone; waiting 12 s for others"}


def test_a_lost_scheduler_is_told_in_one_line(client):
    def slow(tree, seed):
        time.sleep(0.1)
        return work(tree, seed)

    running = run_trials(client, trials(20), work=slow)
    next(running)
    # What the client does to its futures as the scheduler goes.
    client.cancel([Future(key, client) for key in list(client.futures)])
    with pytest.raises(DataError, match="connection to the Dask scheduler is lost"):
        list(running)


def test_the_dashboard_is_named_where_the_scheduler_has_bokeh(client, monkeypatch):
    monkeypatch.setattr(cluster, "find_spec", lambda name: None)
    assert cluster.watch_at(client) == f"scheduler: {client.scheduler.address}"
    monkeypatch.setattr(cluster, "find_spec", lambda name: ModuleSpec(name, None))
    monkeypatch.setattr(Client, "dashboard_link", "http://127.0.0.1:8787/status")
    assert cluster.watch_at(client) == "dashboard: http://127.0.0.1:8787/status"


def test_there_must_be_a_scheduler_file(tmp_path):
    with (
        pytest.raises(ConfigError, match="there is no such file"),
        Cluster(None, tmp_path / "none").connect(),
    ):
        pass


@pytest.mark.parametrize("content", [None, "", "-----BEGIN CERTIFICATE-----\nx\n-----END CERTIFICATE-----\n"])
def test_credentials_that_cannot_be_read_are_told(content, tmp_path):
    path = tmp_path / "pem"
    if content is not None:
        path.write_text(content, encoding="utf-8")
    with pytest.raises(ConfigError, match="expected two certificates and the key of the second") as told:
        Tls(path, path, path).security()
    assert len(str(told.value).splitlines()) == 1


def test_without_credentials_of_its_own_a_tls_address_does_not_answer():
    with (
        pytest.raises(ConfigError, match="no Dask scheduler answers there"),
        Cluster("tls://127.0.0.1:1").connect(),
    ):
        pass
