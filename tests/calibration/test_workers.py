"""Workers of the calibration: lost ones are replaced, and none outlives who started it."""

import os
import signal
import sys
import time
import uuid
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.study.processes import DEADLINE, environment, python, until
from vislam.base.errors import DivergedError
from vislam.base.workers import Workers, _deferred_interrupt

CONFIG = """\
name: small
data:
  simulation: {frames: 60, tracks_in_view: 20, gyro_bias: [0.004, -0.003, 0.005], clock_offset: 0.05}
  repair: {clock: {offset: 0.05}}
noise: {pixel_sigma_px: 0.8, drift_px: 0.05}
estimators: {ekf: {}}
seed: 1
"""
MARK = "VISLAM_TEST_MARK"
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are looked for in /proc")


def square(number):
    return number * number


def killed_once(job):
    """Die the first time, leaving a file behind; answer the second."""
    file, number = job
    if number == 3 and not file.exists():
        file.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return number


def killed(number):
    os.kill(os.getpid(), signal.SIGKILL)


def failing(number):
    raise ValueError(f"no {number}")


def waiting(seconds):
    time.sleep(seconds)


def children():
    """Living children of this process, but for multiprocessing's own tracker."""
    found = []
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            text = status.read_text()
            line = (status.parent / "cmdline").read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue
        alive = "\nState:\tZ" not in text and "resource_tracker" not in line
        if alive and f"\nPPid:\t{os.getpid()}\n" in text:
            found.append(int(status.parent.name))
    return found


@contextmanager
def workers(said=None):
    """Two workers; in the end no process is left of them."""
    before = set(children())
    found = Workers(2, say=[].append if said is None else said.append)
    try:
        yield found
    finally:
        found.close()
        until(lambda: set(children()) <= before)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_waits_until_processes_have_started(number):
    """Also one that the mask lets through, as multiprocessing's tracker has it do once it was started."""
    after, told = [], []
    before = signal.signal(number, lambda number, _: told.append(number))
    try:
        with _deferred_interrupt():
            signal.pthread_sigmask(signal.SIG_UNBLOCK, {number})
            os.kill(os.getpid(), number)
            time.sleep(0.01)
            after.append(list(told))
        assert after == [[]]
        assert told == [number]
    finally:
        signal.signal(number, before)


@pytest.mark.slow
def test_answers_come_in_order_again_and_again():
    with workers() as found:
        assert found.map(square, range(9)) == [number**2 for number in range(9)]
        assert found.map(square, []) == []
        assert found.map(square, [7]) == [49]
        with pytest.raises(ValueError, match="no 1"):
            found.map(failing, [1])


@pytest.mark.slow
def test_a_lost_worker_is_replaced_and_its_job_done_again(tmp_path):
    said = []
    with workers(said) as found:
        jobs = [(tmp_path / "dead", number) for number in range(6)]
        assert found.map(killed_once, jobs) == list(range(6))
        assert found.map(square, [3]) == [9]
    assert said == ["a worker process was lost; starting anew (1 of 3)"]


@pytest.mark.slow
def test_workers_that_are_lost_again_and_again_end_it_with_one_line():
    said = []
    with (
        workers(said) as found,
        pytest.raises(DivergedError, match=r"lost 4 times.*use one process") as ended,
    ):
        found.map(killed, range(4))
    assert "\n" not in str(ended.value)
    assert len(said) == 3


@pytest.mark.slow
def test_closing_does_not_wait_for_what_a_worker_is_doing():
    with workers() as found:
        found._submit(waiting, [3600.0, 3600.0])
        until(lambda: len(children()) >= 2)


# The command as a process ----------------------------------------------------------------------------------


@contextmanager
def command(folder, *more):
    """The command on a small drive with two workers, and the mark that all its processes carry."""
    (folder / "small.yaml").write_text(CONFIG, encoding="utf-8")
    mark = uuid.uuid4().hex
    arguments = ("-m", "vislam.calibrate", "--config", folder / "small.yaml", "--out", folder / "best.yaml")
    env = {**environment(), MARK: mark}
    with python(*arguments, "--processes", "2", *more, env=env, start_new_session=True) as process:
        yield process, mark


def marked(mark):
    """Processes that carry a mark in their environment, by their command lines."""
    found = {}
    for place in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}".encode() in (place / "environ").read_bytes():
                found[int(place.name)] = (place / "cmdline").read_bytes()
        except (FileNotFoundError, ProcessLookupError, PermissionError):
            continue
    return found


def spawned(mark):
    return [number for number, line in marked(mark).items() if b"spawn_main" in line]


def unfinished(folder):
    return (folder / "best.yaml").read_text(encoding="utf-8").startswith("# calibration unfinished: choice ")


def until_a_round_is_over(folder):
    until((folder / "best.yaml").exists)
    assert unfinished(folder)


@pytest.mark.slow
def test_the_command_survives_a_killed_worker(tmp_path):
    with command(tmp_path) as (process, mark):
        until_a_round_is_over(tmp_path)
        os.kill(spawned(mark)[0], signal.SIGKILL)
        out, err = process.communicate(timeout=DEADLINE)
        # Whether what was found predicts better, or the config from before is written again.
        assert process.returncode in (0, 3)
        assert out.count("a worker process was lost; starting anew (1 of 3)") == 1
        assert err == ""
        assert not unfinished(tmp_path)
        until(lambda: not marked(mark))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "whom"), [(signal.SIGTERM, "process"), (signal.SIGTERM, "group"), (signal.SIGINT, "group")]
)
def test_an_interrupted_command_leaves_the_best_and_no_worker(number, whom, tmp_path):
    with command(tmp_path) as (process, mark):
        until_a_round_is_over(tmp_path)
        (os.killpg if whom == "group" else os.kill)(process.pid, number)
        out, err = process.communicate(timeout=DEADLINE)
        assert process.returncode == 130
        assert err == "vislam: interrupted\n"
        assert "best config so far (choice " in out.splitlines()[-1]
        assert unfinished(tmp_path)
        until(lambda: not marked(mark))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_an_interrupt_while_workers_start_leaves_none(number, tmp_path):
    with command(tmp_path) as (process, mark):
        until(lambda: spawned(mark))
        os.killpg(process.pid, number)
        assert process.communicate(timeout=DEADLINE)[1] == "vislam: interrupted\n"
        assert process.returncode == 130
        until(lambda: not marked(mark))


@pytest.mark.slow
def test_no_worker_outlives_a_command_that_was_killed(tmp_path):
    with command(tmp_path) as (process, mark):
        until_a_round_is_over(tmp_path)
        assert len(spawned(mark)) == 2
        process.kill()
        process.wait(timeout=DEADLINE)
        until(lambda: not marked(mark))
        assert unfinished(tmp_path)
