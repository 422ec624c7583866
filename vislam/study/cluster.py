"""Trials on Dask workers: processes of this machine, or a cluster that runs already."""

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

import dask
from distributed import Client, LocalCluster, as_completed
from distributed.client import ClosedClientError
from distributed.comm import CommClosedError

from vislam.errors import ConfigError, DataError, first_line
from vislam.identity import code_digest
from vislam.study.points import Trial
from vislam.study.trial import nothing, run_trial

LOST = "lost"
"""Status of a trial whose workers died with it; the next start of the study runs it again."""
_OUTSTANDING = 4
"""Trials that are under way or wait, for each worker."""
_RETRIES = 2
_LOCAL = {"distributed.worker.profile.enabled": False}
"""Dask would look a hundred times a second at what a worker does, for a profile that nobody asks for."""
_PATIENCE = 30.0
"""How long to wait for a scheduler, and for its first worker [s]."""


@dataclass(frozen=True)
class Cluster:
    """Where the trials run: the scheduler's address, or that of its file; neither: processes of this machine.

    Attributes
    ----------
    scheduler : str or None
    scheduler_file : Path or None
    workers : int or None
        Number of processes; None: one for each CPU.
    """

    scheduler: str | None = None
    scheduler_file: Path | None = None
    workers: int | None = None

    @contextmanager
    def connect(self) -> Iterator[Client]:
        """Give a client of workers that have the same code; ConfigError if there are none."""
        for name in ("distributed", "distributed.client"):
            # Who comes and goes is not news; what goes wrong with a trial is in its result.
            logging.getLogger(name).setLevel(logging.CRITICAL)
        if self.scheduler is None and self.scheduler_file is None:
            with _local(self.workers) as cluster, Client(cluster) as client:
                yield client
            return
        where = self.scheduler or str(self.scheduler_file)
        with _remote(where, self.scheduler, self.scheduler_file) as client:
            _refuse_other_workers(client, where)
            yield client


def run_trials(
    client: Client,
    trials: Iterator[Trial],
    *,
    work: Callable[[Any, int], dict[str, Any]] = run_trial,
) -> Iterator[tuple[Trial, dict[str, Any]]]:
    """Run trials and give each with its result, as they finish.

    Only a few for each worker are handed out at a time, and each is forgotten once it is here, so that what
    is held does not grow with their number. A trial that a worker took down with it goes to another.

    Raises
    ------
    ConfigError
        If a worker that joined later has other code. One that has none drops out by itself.
    DataError
        If the scheduler is lost.
    """
    under_way: dict[str, Trial] = {}
    finished = as_completed()

    def top_up() -> None:
        with _told():
            # Workers come and go: a cluster's queue lets them in one after the other.
            window = _OUTSTANDING * max(1, sum(client.nthreads().values()))
            for trial in islice(trials, max(0, window - len(under_way))):
                key = f"trial-{trial.id}"
                under_way[key] = trial
                tree, seed = trial.point.tree, trial.seed
                finished.add(client.submit(work, tree, seed, key=key, retries=_RETRIES, pure=False))

    top_up()
    for future in finished:
        trial = under_way.pop(future.key)
        with _told():
            result = _result(future)
        future.release()
        top_up()
        yield trial, result


def watch_at(client: Client) -> str:
    """Where to watch the workers: the dashboard needs bokeh where the scheduler runs, nothing else does."""
    if client.run_on_scheduler(find_spec, "bokeh") is None:
        return f"scheduler: {client.scheduler.address}"
    return f"dashboard: {client.dashboard_link}"


def _result(future: Any) -> dict[str, Any]:
    """Result of a finished trial, or what there is to say of one whose workers died."""
    try:
        result: dict[str, Any] = future.result()
    except (CancelledError, ClosedClientError, CommClosedError):
        raise
    except Exception as error:
        # The trial itself turns what goes wrong into a result: this is its worker.
        reason = f"{type(error).__name__}: {first_line(error)}"
        return {**nothing(LOST, reason), "seconds": None, "code": code_digest()}
    if result["code"] != code_digest():
        raise ConfigError(_other_code(result["code"], "a worker"))
    return result


@contextmanager
def _told() -> Iterator[None]:
    """Say in one line that the scheduler is gone."""
    try:
        yield
    except (CancelledError, ClosedClientError, CommClosedError):
        raise DataError(
            "the connection to the Dask scheduler is lost; finished trials are kept, run the study again"
        ) from None


@contextmanager
def _local(workers: int | None) -> Iterator[LocalCluster]:
    """Processes of this machine, one thread each, whose BLAS Dask keeps to one as well."""
    with (
        dask.config.set(_LOCAL),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
            preload="vislam.study.local_worker",
        ) as cluster,
    ):
        yield cluster


@contextmanager
def _remote(where: str, address: str | None, file: Path | None) -> Iterator[Client]:
    if file is not None and not file.is_file():
        raise ConfigError(f"--scheduler-file {file}: there is no such file; is the scheduler running?")
    try:
        client = Client(address, scheduler_file=None if file is None else str(file), timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{where}: no Dask scheduler answers there ({first_line(error)})") from None
    with client:
        yield client


def _refuse_other_workers(client: Client, where: str) -> None:
    """Raise ConfigError unless there are workers and all have this code."""
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
        found = client.run(_ready)
    except TimeoutError:
        raise ConfigError(f"{where}: the scheduler has no worker; start one with dask worker") from None
    except Exception as error:
        # Whatever unpickling or importing the package raises over there.
        raise ConfigError(
            f"{where}: a worker cannot import vislam ({first_line(error)}); install it there as it is here"
        ) from None
    for worker, code in found.items():
        if code != code_digest():
            raise ConfigError(_other_code(code, f"worker {worker}"))


def _ready() -> str:
    """Import what the first trial would import, and give the code of this process."""
    import gtsam  # noqa: F401, PLC0415

    return code_digest()


def _other_code(code: str, who: str) -> str:
    return f"{who} has vislam of code {code}, here it is {code_digest()}; install the same there"
