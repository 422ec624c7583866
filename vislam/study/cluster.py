"""Trials on Dask workers: processes of this machine, or a cluster that runs already."""

import logging
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any

from distributed import Client, as_completed
from distributed.client import ClosedClientError
from distributed.comm import CommClosedError

from vislam.base.errors import ConfigError, DataError, first_line
from vislam.comparison.identity import code_digest
from vislam.study.connection import Tls, WorkersGone, local_client, other_code, remote_client
from vislam.study.points import Trial
from vislam.study.trial import nothing, run_trial

LOST = "lost"
"""Status of a trial whose workers died with it; the next start of the study runs it again."""
PATIENCE = 60.0
"""How long to wait for a worker of a scheduler that runs already, at the start and once all are gone [s]."""
_OUTSTANDING = 4
"""Tasks that are under way or wait, for each worker."""
_TASK_TIME, _MOST_OF_TASK = 0.5, 16
"""Trials that are shorter than this go several to a task, until it takes as long [s], and so many at most:
a task costs scheduler, driver and worker some 10 ms whatever it does."""
_RETRIES = 2
_RESTARTING = 20.0
"""How long Dask may take to start killed processes of this machine again [s]; it gives up after 15."""
_READY, _LOOK, _SHORT = 0.01, 1.0, 3.0
"""How often to look for a finished trial and for workers, and absence of workers that is not told [s]."""


@dataclass(frozen=True)
class Cluster:
    """Where the trials run: the scheduler's address, or that of its file; neither: processes of this machine.

    Attributes
    ----------
    scheduler : str or None
    scheduler_file : Path or None
    workers : int or None
        Number of processes; None: one for each CPU.
    tls : Tls or None
        Credentials for the scheduler; None: those of Dask's own configuration, if it has any. Processes of
        this machine have some that are made for the run and known to nobody else.
    patience : float
        How long to wait for a worker of the scheduler [s].
    """

    scheduler: str | None = None
    scheduler_file: Path | None = None
    workers: int | None = None
    tls: Tls | None = None
    patience: float = PATIENCE

    @property
    def local(self) -> bool:
        """Whether the workers are processes of this machine, which can be started again."""
        return self.scheduler is None and self.scheduler_file is None

    @contextmanager
    def connect(self) -> Iterator[Client]:
        """Give a client of workers that have the same code.

        Raises
        ------
        ConfigError
            If a scheduler that is named does not answer, or has no worker or one of other code.
        WorkersGone
            If processes of this machine cannot be started.
        """
        for name in ("distributed", "distributed.client", "asyncio"):
            # Who comes and goes is not news; what goes wrong with a trial is in its result.
            logging.getLogger(name).setLevel(logging.CRITICAL)
        to = (
            local_client(self.workers)
            if self.local
            else remote_client(self.scheduler, self.scheduler_file, tls=self.tls, patience=self.patience)
        )
        with to as client:
            yield client


def run_trials(
    client: Client,
    trials: Iterator[Trial],
    *,
    work: Callable[[Any, int], dict[str, Any]] = run_trial,
    patience: float = PATIENCE,
    say: Callable[[str], None] = lambda text: None,
) -> Iterator[tuple[Trial, dict[str, Any]]]:
    """Run trials and give each with its result, as they finish.

    Only a few for each worker are handed out at a time, and each is forgotten once it is here, so that what
    is held does not grow with their number. Short ones go several to a task. A trial that a worker took down
    with it goes to another, by itself.

    Parameters
    ----------
    client : Client
    trials : iterator of Trial
    work : callable
        Runs a trial's config with its seed.
    patience : float
        How long to wait for a worker once there is none [s]; processes of this machine are back sooner.
    say : callable
        Told when there is none.

    Raises
    ------
    ConfigError
        If a worker that joined later has other code or other data. One that has none drops out by itself.
    DataError
        If the scheduler is lost.
    WorkersGone
        If there is no worker left.
    """
    patience = patience if client.cluster is None else _RESTARTING
    under_way: dict[str, list[Trial]] = {}
    alone: deque[Trial] = deque()
    finished, pace = as_completed(), _Pace()

    def top_up() -> None:
        with _told():
            # Workers come and go: a cluster's queue lets them in one after the other.
            window = _OUTSTANDING * max(1, sum(client.nthreads().values()))
        while len(under_way) < window:
            some = [alone.popleft()] if alone else list(islice(trials, pace.trials))
            if not some:
                return
            key = f"{'trial' if len(some) == 1 else 'trials'}-{some[0].id}"
            under_way[key] = some
            jobs = [(trial.point.tree, trial.seed) for trial in some]
            with _told():
                finished.add(client.submit(_each, work, jobs, key=key, retries=_RETRIES, pure=False))

    top_up()
    while under_way:
        _wait(client, finished, patience=patience, say=say)
        future = next(finished)
        some = under_way.pop(future.key)
        with _told():
            results = _results(future, some)
        future.release()
        if not results:
            alone.extend(some)
        pace.take(results)
        top_up()
        yield from zip(some, results, strict=False)


class _Pace:
    """How many trials go to a task, by how long the last ones took."""

    def __init__(self) -> None:
        self.trials = 1

    def take(self, results: Sequence[dict[str, Any]]) -> None:
        """Take the results of a task."""
        taken = [result["seconds"] for result in results if result.get("seconds") is not None]
        if taken:
            longest = max(*taken, _TASK_TIME / _MOST_OF_TASK)
            self.trials = max(1, int(_TASK_TIME / longest))


def _each(
    work: Callable[[Any, int], dict[str, Any]], jobs: Sequence[tuple[Any, int]]
) -> list[dict[str, Any]]:
    """Run the trials of a task, on a worker."""
    return [work(tree, seed) for tree, seed in jobs]


def _wait(client: Client, finished: as_completed, *, patience: float, say: Callable[[str], None]) -> None:
    """Wait until a trial has finished; WorkersGone if there has been no worker for that long."""
    seen = looked = time.monotonic()
    told = False
    while not finished.has_ready():
        time.sleep(_READY)
        now = time.monotonic()
        if now < looked + _LOOK:
            continue
        looked = now
        with _told():
            if client.nthreads():
                seen, told = now, False
        if now >= seen + patience:
            raise WorkersGone(f"all workers are gone, for {patience:.0f} s now")
        if now >= seen + _SHORT and not told:
            told = True
            say(f"all workers are gone; waiting {patience:.0f} s for others")


def watch_at(client: Client) -> str:
    """Where to watch the workers: the dashboard needs bokeh where the scheduler runs, nothing else does."""
    if client.run_on_scheduler(find_spec, "bokeh") is None:
        return f"scheduler: {client.scheduler.address}"
    return f"dashboard: {client.dashboard_link}"


def _results(future: Any, some: Sequence[Trial]) -> list[dict[str, Any]]:
    """Results of a finished task; of one whose workers died the record that says so, or none of several."""
    try:
        results: list[dict[str, Any]] = future.result()
    except (CancelledError, ClosedClientError, CommClosedError):
        raise
    except Exception as error:
        if len(some) > 1:
            return []
        # The trial itself turns what goes wrong into a result: this is its worker.
        lost = nothing(LOST, f"{type(error).__name__}: {first_line(error)}")
        return [{**lost, "seconds": None, "code": code_digest(), "inputs": some[0].point.inputs}]
    for trial, result in zip(some, results, strict=True):
        _refuse_other(trial, result)
    return results


def _refuse_other(trial: Trial, result: dict[str, Any]) -> None:
    """Raise ConfigError if a worker has other code, or has read other files."""
    if result["code"] != code_digest():
        raise ConfigError(other_code(result["code"], "a worker"))
    if result["inputs"] != trial.point.inputs:
        raise ConfigError(
            "a worker has read other files than those that the config names here, or they have been changed "
            "since the start; let both be the same and run the study again"
        )


@contextmanager
def _told() -> Iterator[None]:
    """Report in one line that the scheduler was lost."""
    try:
        yield
    except (CancelledError, ClosedClientError, OSError):
        raise DataError(
            "the connection to the Dask scheduler is lost; finished trials are kept, run the study again"
        ) from None
