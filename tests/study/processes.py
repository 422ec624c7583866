"""A Dask scheduler and workers as processes of their own, as on a cluster."""

import json
import os
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
from distributed.security import Security

ROOT = Path(__file__).parents[2]
DEADLINE = 240.0
"""Time after which what has not happened will not happen, on a machine with much else to do [s]."""


def environment(*first):
    """Environment of a process that looks for packages in these folders, then in the repository."""
    path = os.pathsep.join(str(folder) for folder in (*first, ROOT))
    return {**os.environ, "PYTHONPATH": path}


@contextmanager
def python(*arguments, env=None, **options):
    """Give a process of Python, killed in the end with all that it has started.

    What outlives it holds its output open, and whoever waits for the end of that waits for good.
    """
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
        family = descendants(process)
        process.kill()
        for one in family:
            with suppress(psutil.Error):
                one.kill()
        process.communicate(timeout=DEADLINE)


def descendants(process):
    """Processes that a process has started, and those that these have."""
    try:
        return psutil.Process(process.pid).children(recursive=True)
    except psutil.Error:
        return []


@contextmanager
def scheduler(folder, *options):
    """Give a scheduler's process and its file, which names its address, on a port of its own choice."""
    file = folder / "scheduler.json"
    place = ("--port", "0", "--dashboard-address", "127.0.0.1:0", *(options or ("--host", "127.0.0.1")))
    with python("-m", "dask", "scheduler", *place, "--scheduler-file", file) as process:
        until(lambda: file.is_file() and file.read_text(encoding="utf-8").endswith("}"))
        yield process, file


def worker(file, *options, env=None):
    """Process of a worker with one thread; it starts where there is no vislam to be found by chance."""
    place = options or ("--host", "127.0.0.1")
    arguments = ("--nthreads", "1", "--no-nanny", "--no-dashboard", *place)
    return python("-m", "dask", "worker", "--scheduler-file", file, *arguments, env=env, cwd=file.parent)


def credentials(folder):
    """Files of a certificate and its key, rebuilt: the options of the study, and those of Dask."""
    made = Security.temporary()
    folder.mkdir()
    for name, text in (("cert.pem", made.tls_client_cert), ("key.pem", made.tls_client_key)):
        (folder / name).write_text(text, encoding="utf-8")
    cert, key = folder / "cert.pem", folder / "key.pem"
    ours = ("--tls-ca", cert, "--tls-cert", cert, "--tls-key", key)
    return ours, ("--protocol", "tls", "--tls-ca-file", cert, "--tls-cert", cert, "--tls-key", key)


def workers_of(process):
    """Workers that a study has started on this machine."""
    try:
        return [
            child for child in descendants(process) if any("spawn_main" in part for part in child.cmdline())
        ]
    except psutil.Error:
        return []


def address(file):
    """Address of the scheduler."""
    return json.loads(file.read_text(encoding="utf-8"))["address"]


def until(condition):
    """Wait for a condition."""
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < DEADLINE, "it did not happen"
        time.sleep(0.02)
