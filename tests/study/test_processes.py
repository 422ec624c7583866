"""A study on a real scheduler and real workers: what dies, is missing or is another version."""

import asyncio
import os
import resource
import shutil
import signal
import sys
import time
from collections import Counter
from contextlib import suppress
from itertools import count
from pathlib import Path

import psutil
import pytest
from distributed.comm import connect
from distributed.security import Security
from threadpoolctl import threadpool_info

from tests.study.processes import (
    DEADLINE,
    ROOT,
    address,
    credentials,
    environment,
    python,
    scheduler,
    until,
    worker,
    workers_of,
)
from vislam.base.errors import ConfigError, DataError
from vislam.comparison import config as configuration
from vislam.comparison.identity import code_digest
from vislam.study.cluster import Cluster, run_trials
from vislam.study.plan import Plan
from vislam.study.points import Point, all_trials
from vislam.study.trial import DONE

pytestmark = pytest.mark.slow
TRIALS = 30
SETS = count()
CONFIG = """
name: small
data: {simulation: {frames: 25, tracks_in_view: 20}}
estimators: {dead_reckoning: {}, ekf: {}}
study: {seeds: 40}
"""


def logged(folder, seconds):
    """Work that leaves a file for each start and each end: ``<what>-<seed>-<process>``."""
    code = code_digest()

    def work(tree, seed):
        (folder / f"start-{seed}-{os.getpid()}").touch()
        time.sleep(seconds)
        (folder / f"end-{seed}-{os.getpid()}").touch()
        return {"status": "done", "code": code, "inputs": ""}

    return work


def trials(number=TRIALS):
    return all_trials([Point({}, {})], seeds=range(number), code=str(next(SETS)))


def files(folder, what):
    """(seed, process) of each start or end."""
    return {tuple(map(int, path.name.split("-")[1:])) for path in folder.glob(f"{what}-*")}


def small(folder):
    """Config of trials that take a few tenths of a second."""
    config = folder / "small.yaml"
    config.write_text(CONFIG, encoding="utf-8")
    return config


def planned(folder, *, seeds):
    """Trials of that config."""
    return Plan.of(configuration.load(small(folder), overrides={"study.seeds": seeds})).trials()


def command(folder, *options, **how):
    """The command on a small study."""
    arguments = ("-m", "vislam.study", "--config", small(folder), "--out", folder / "out")
    return python(*arguments, *options, **how)


def without_vislam(folder):
    """Environment of a process that does not find the package."""
    place = folder / "python"
    place.mkdir()
    (place / "sitecustomize.py").write_text("import sys\nsys.modules['vislam'] = None\n", encoding="utf-8")
    return environment(place)


def other_vislam(folder):
    """Environment of a process that finds the package with a line more."""
    package = folder / "python" / "vislam"
    shutil.copytree(ROOT / "vislam", package, ignore=shutil.ignore_patterns("__pycache__"))
    with (package / "motion.py").open("a", encoding="utf-8") as file:
        file.write("\n# A change.\n")
    return environment(package.parent)


def test_a_killed_worker_costs_no_trial_and_repeats_only_what_it_held(tmp_path):
    with scheduler(tmp_path) as (_, file), worker(file) as first, worker(file) as second:
        with Cluster(scheduler=address(file)).connect() as client:
            client.wait_for_workers(2)
            found = []
            for trial, result in run_trials(client, trials(), work=logged(tmp_path, 0.2)):
                found.append((trial.seed, result["status"]))
                if len(found) == TRIALS // 3:
                    first.kill()
        assert second.poll() is None
    assert sorted(found) == [(seed, DONE) for seed in range(TRIALS)]
    starts = Counter(seed for seed, _ in files(tmp_path, "start"))
    repeated = {seed for seed, number in starts.items() if number > 1}
    # One under way; another if its result was not handed over yet.
    assert len(repeated) <= 2
    assert {seed for seed, process in files(tmp_path, "start") if process == first.pid} >= repeated
    assert sum(starts.values()) <= TRIALS + 2


def test_a_scheduler_that_dies_is_told(tmp_path):
    with (
        scheduler(tmp_path) as (process, file),
        worker(file),
        Cluster(scheduler_file=file).connect() as client,
    ):
        running = run_trials(client, trials(), work=logged(tmp_path, 0.1))
        next(running)
        process.kill()
        with pytest.raises(DataError, match="connection to the Dask scheduler is lost"):
            list(running)


@pytest.mark.parametrize(
    ("other", "said"),
    [(without_vislam, "cannot import vislam"), (other_vislam, "has vislam of code")],
)
def test_a_worker_without_the_package_or_with_another_is_refused(other, said, tmp_path):
    env = other(tmp_path)
    with (
        scheduler(tmp_path) as (_, file),
        worker(file, env=env),
        command(tmp_path, "--scheduler-file", file) as study,
    ):
        out, error = study.communicate(timeout=DEADLINE)
    assert study.returncode == 2
    assert said in error
    assert len(error.splitlines()) == 1
    assert out.splitlines()[1:] == ["40 trials, 0 of them are finished"]
    assert not list((tmp_path / "out").glob("*/*"))


def test_a_worker_of_other_code_that_comes_later_ends_the_study(tmp_path):
    env = other_vislam(tmp_path)
    with scheduler(tmp_path) as (_, file), worker(file), Cluster(scheduler_file=file).connect() as client:
        running = run_trials(client, planned(tmp_path, seeds=400))
        next(running)
        with worker(file, env=env), pytest.raises(ConfigError, match="a worker has vislam of code"):
            list(running)


def test_a_worker_without_the_package_that_comes_later_drops_out(tmp_path):
    env = without_vislam(tmp_path)
    with scheduler(tmp_path) as (_, file), worker(file), Cluster(scheduler_file=file).connect() as client:
        running = run_trials(client, planned(tmp_path, seeds=20))
        next(running)
        with worker(file, env=env) as late:
            # It may have come and gone between two looks.
            until(lambda: late.poll() is not None or len(client.scheduler_info()["workers"]) > 1)
            assert [result["status"] for _, result in running] == [DONE] * 19
            until(lambda: late.poll() is not None)


def test_a_killed_driver_leaves_no_process_and_its_study_goes_on(tmp_path):
    with command(tmp_path, "--workers", "2") as study:
        until(lambda: len(saved(tmp_path)) >= 5)
        family = psutil.Process(study.pid).children(recursive=True)
        study.send_signal(signal.SIGKILL)
        assert len(family) >= 2
        _, alive = psutil.wait_procs(family, timeout=DEADLINE)
        assert alive == []
    finished = {path: path.stat().st_mtime_ns for path in saved(tmp_path)}
    assert 5 <= len(finished) < 40
    with command(tmp_path, "--workers", "2") as study:
        out, error = study.communicate(timeout=DEADLINE)
    assert (study.returncode, error) == (0, "")
    assert f"40 trials, {len(finished)} of them are finished" in out
    assert {path: path.stat().st_mtime_ns for path in finished} == finished
    assert len(saved(tmp_path)) == 40


def test_workers_of_this_machine_have_one_blas_thread_and_have_imported_the_solvers(monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)

    def state():
        threads = {library["num_threads"] for library in threadpool_info()}
        return threads, "gtsam" in sys.modules

    with Cluster(workers=2).connect() as client:
        assert list(client.run(state).values()) == [({1}, True)] * 2


def test_a_file_system_that_takes_no_more_ends_the_study_with_a_line(tmp_path):
    def little():
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))

    with command(tmp_path, "--workers", "2", preexec_fn=little) as study:
        _, error = study.communicate(timeout=DEADLINE)
    assert study.returncode == 2
    assert "cannot be written (File too large); finished trials are kept" in error
    assert len(error.splitlines()) == 1
    assert not list((tmp_path / "out").glob("*/trials/*"))


def saved(folder):
    return list((folder / "out").glob("*/trials/*.json"))


def reach(where, security):
    """Open a connection as a client does, and close it."""

    async def handshake():
        comm = await connect(where, timeout=5, **security.get_connection_args("client"))
        await comm.close()

    asyncio.run(handshake())


def test_workers_of_this_machine_are_nobody_elses():
    with Cluster(workers=1).connect() as client:
        places = [client.scheduler.address, *client.nthreads()]
        assert len(places) == 2
        for place in places:
            assert place.startswith("tls://127.0.0.1:")
            reach(place, client.security)
            for where, security in (
                (place.replace("tls", "tcp"), Security()),
                (place, Security.temporary()),
            ):
                with pytest.raises(OSError, match=r"(?i)tcp|tls"):
                    reach(where, security)


def test_a_scheduler_by_tls_takes_who_has_its_credentials(tmp_path):
    ours, theirs = credentials(tmp_path / "pem")
    others, _ = credentials(tmp_path / "others")
    host = ("--host", "tls://127.0.0.1")
    with scheduler(tmp_path, *host, *theirs) as (_, file), worker(file, *theirs):
        assert address(file).startswith("tls://")
        with command(tmp_path, "--scheduler", address(file), *ours, "--set", "study.seeds=3") as study:
            out, error = study.communicate(timeout=DEADLINE)
        assert (study.returncode, error) == (0, "")
        assert "3 trials, 0 of them are finished" in out
        for given in ((), others):
            with command(tmp_path, "--scheduler-file", file, *given) as study:
                _, error = study.communicate(timeout=DEADLINE)
            assert study.returncode == 2
            assert "no Dask scheduler answers there" in error
            assert len(error.splitlines()) == 1


def test_the_credentials_may_come_from_the_configuration_of_dask(tmp_path):
    _, theirs = credentials(tmp_path / "pem")
    names = {"CA_FILE": "cert", "CLIENT__CERT": "cert", "CLIENT__KEY": "key"}
    env = environment() | {
        f"DASK_DISTRIBUTED__COMM__TLS__{name}": str(tmp_path / "pem" / f"{file}.pem")
        for name, file in names.items()
    }
    with (
        scheduler(tmp_path, "--host", "tls://127.0.0.1", *theirs) as (_, file),
        worker(file, *theirs),
        command(tmp_path, "--scheduler-file", file, "--set", "study.seeds=2", env=env) as study,
    ):
        _, error = study.communicate(timeout=DEADLINE)
    assert (study.returncode, error) == (0, "")


def test_a_scheduler_whose_workers_are_all_gone_ends_the_study_with_what_there_is(tmp_path):
    with (
        scheduler(tmp_path) as (_, file),
        worker(file) as only,
        command(tmp_path, "--scheduler-file", file, "--wait-for-workers", "8") as study,
    ):
        until(lambda: len(saved(tmp_path)) >= 3)
        only.kill()
        out, error = study.communicate(timeout=DEADLINE)
    assert (study.returncode, error) == (1, "")
    assert "all workers are gone; waiting 8 s for others\n" in out
    assert "all workers are gone, for 8 s now; what has finished is kept\n" in out
    kept = len(saved(tmp_path))
    assert 3 <= kept < 40
    assert f"{40 - kept} trials were lost with their workers, or there was none left for them" in out
    (table,) = (tmp_path / "out").glob("*/trials.csv")
    assert len(table.read_text(encoding="utf-8").splitlines()) == 1 + kept
    assert table.with_name("study.html").is_file()


def test_workers_that_are_killed_as_they_start_end_the_study_with_lines(tmp_path):
    with command(tmp_path, "--workers", "2") as study:
        while study.poll() is None:
            for process in workers_of(study):
                with suppress(psutil.Error):
                    process.kill()
            time.sleep(0.02)
        out, error = study.communicate(timeout=DEADLINE)
    assert (study.returncode, error) == (1, "")
    assert [
        line.partition(";")[2] for line in out.splitlines() if line.startswith("a worker died as it")
    ] == [
        *(f" starting others ({number} of 3)" for number in (1, 2, 3)),
        " what has finished is kept",
    ]
    assert "40 trials were lost with their workers, or there was none left for them" in out


def test_workers_that_are_killed_once_are_replaced(tmp_path):
    with command(tmp_path, "--workers", "2") as study:
        until(lambda: workers_of(study))
        workers_of(study)[0].kill()
        until(lambda: len(saved(tmp_path)) >= 3)
        for process in workers_of(study):
            process.kill()
        out, error = study.communicate(timeout=DEADLINE)
    assert (study.returncode, error) == (0, "")
    assert "a worker died as it started (Nanny failed to start.); starting others (1 of 3)\n" in out
    assert len(saved(tmp_path)) == 40


def started(study, folder):
    return workers_of(study)


def running(study, folder):
    return saved(folder)


@pytest.mark.parametrize("moment", [started, running])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_leaves_one_line_and_no_worker(moment, number, tmp_path):
    """A terminal sends Ctrl-C to the workers, too."""
    with command(tmp_path, "--workers", "2", start_new_session=True) as study:
        until(lambda: moment(study, tmp_path))
        family = workers_of(study)
        if number == signal.SIGINT:
            os.killpg(study.pid, number)
        else:
            study.send_signal(number)
        _, error = study.communicate(timeout=DEADLINE)
        assert (study.returncode, error) == (130, "vislam: interrupted\n")
        assert psutil.wait_procs(family, timeout=DEADLINE)[1] == []


def test_a_thousand_trials_take_no_more_memory_than_a_hundred(tmp_path):
    with python(Path(__file__).with_name("thousand.py"), tmp_path / "study") as process:
        out, error = process.communicate(timeout=DEADLINE)
    assert process.returncode == 0, error
    ran, concluded = ([float(item) for item in line.split()] for line in out.splitlines())
    # A result takes over 0.1 MB; Dask keeps the last thousand events of each kind.
    assert ran[-1] - ran[0] < 60.0
    assert concluded[-1] - concluded[0] < 30.0
