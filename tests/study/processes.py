"""A Dask scheduler and workers as processes of their own, as on a cluster."""

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).parents[2]
DEADLINE = 60.0


def environment(*first):
    """Environment of a process that looks for packages in these folders, then in the repository."""
    path = os.pathsep.join(str(folder) for folder in (*first, ROOT))
    return {**os.environ, "PYTHONPATH": path}


@contextmanager
def python(*arguments, env=None, **options):
    """Give a process of Python, killed in the end."""
    process = subprocess.Popen(
        [sys.executable, *map(str, arguments)],
        env=environment() if env is None else env,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@contextmanager
def scheduler(folder):
    """Give a scheduler's process and its file, which names its address, on a port of its own choice."""
    file = folder / "scheduler.json"
    place = ("--host", "127.0.0.1", "--port", "0", "--dashboard-address", "127.0.0.1:0")
    with python("-m", "dask", "scheduler", *place, "--scheduler-file", file) as process:
        until(lambda: file.is_file() and file.read_text(encoding="utf-8").endswith("}"))
        yield process, file


def worker(file, *, env=None):
    """Process of a worker with one thread; it starts where there is no vislam to be found by chance."""
    arguments = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")
    return python("-m", "dask", "worker", "--scheduler-file", file, *arguments, env=env, cwd=file.parent)


def address(file):
    """Address of the scheduler."""
    return json.loads(file.read_text(encoding="utf-8"))["address"]


def until(condition):
    """Wait for a condition."""
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < DEADLINE, "it did not happen"
        time.sleep(0.02)
