"""Ways to Dask workers: processes of this machine, or a scheduler that runs already."""

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import resource_tracker
from pathlib import Path

import dask
from distributed import Client, LocalCluster
from distributed.security import Security

from vislam.base.errors import ConfigError, first_line
from vislam.comparison.identity import code_digest

_LOCAL = {"distributed.worker.profile.enabled": False}
"""Dask would look a hundred times a second at what a worker does, for a profile that nobody asks for."""
_CONNECTING = 30.0
"""How long to wait for a scheduler [s]."""


class WorkersGone(Exception):
    """No worker is left, and none joins; the message says so."""


@dataclass(frozen=True)
class Tls:
    """Files in PEM format by which a scheduler, its workers and the study know each other.

    Attributes
    ----------
    ca : Path
        Certificate of who signed those of the others.
    cert, key : Path
        The study's own.
    """

    ca: Path
    cert: Path
    key: Path

    def security(self) -> Security:
        """Credentials as Dask takes them; ConfigError if they cannot be used."""
        found = Security(
            require_encryption=True,
            tls_ca_file=str(self.ca),
            tls_client_cert=str(self.cert),
            tls_client_key=str(self.key),
        )
        try:
            found.get_connection_args("client")
        except OSError as error:
            raise ConfigError(
                f"--tls-ca {self.ca}, --tls-cert {self.cert}, --tls-key {self.key}: expected two "
                f"certificates and the key of the second in PEM format ({first_line(error)})"
            ) from None
        return found


@contextmanager
def local_client(workers: int | None) -> Iterator[Client]:
    """Client of processes of this machine, one thread each, whose BLAS Dask keeps to one as well.

    Who reaches a scheduler or a worker runs code as its owner. So they talk by TLS alone, with credentials
    that are made here and that no other user of the machine has.
    """
    with dask.config.set(_LOCAL):
        try:
            with _whole():
                cluster = LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=logging.CRITICAL,
                    preload="vislam.study.local_worker",
                    security=Security.temporary(),
                )
        except Exception as error:
            # Dask has ended those that did start.
            raise WorkersGone(f"a worker died as it started ({first_line(error)})") from None
        try:
            with Client(cluster) as client:
                yield client
        finally:
            # Of workers that were killed as they started Dask may not know that they are gone.
            with _whole(), suppress(Exception):
                cluster.close()


@contextmanager
def _whole() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait for the end of the block.

    What Dask has half started it cannot end. The threads that are started here, and the processes that these
    start, never see a Ctrl-C, which a terminal sends to all.
    """
    # The first process that is started starts it too, and then lets the signals through again.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGTERM})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def remote_client(
    address: str | None, file: Path | None, *, tls: Tls | None, patience: float
) -> Iterator[Client]:
    """Client of a scheduler that runs, by its address or the file that has it, with workers of this code.

    Raises
    ------
    ConfigError
        If it does not answer, or has no worker after so long [s], or has one of other code.
    """
    where = address or str(file)
    if file is not None and not file.is_file():
        raise ConfigError(f"--scheduler-file {file}: there is no such file; is the scheduler running?")
    security = None if tls is None else tls.security()
    named = None if file is None else str(file)
    try:
        client = Client(address, scheduler_file=named, security=security, timeout=_CONNECTING)
    except (OSError, RuntimeError, TypeError, ValueError) as error:
        # Without credentials, or with those of others, it does not answer either.
        raise ConfigError(f"{where}: no Dask scheduler answers there ({first_line(error)})") from None
    with client:
        _refuse_other_workers(client, where, patience)
        yield client


def _refuse_other_workers(client: Client, where: str, patience: float) -> None:
    """Raise ConfigError unless there are workers and all have this code."""
    try:
        client.wait_for_workers(1, timeout=patience)
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
            raise ConfigError(other_code(code, f"worker {worker}"))


def _ready() -> str:
    """Import what the first trial would import, and give the code of this process."""
    import gtsam  # noqa: F401, PLC0415

    return code_digest()


def other_code(code: str, who: str) -> str:
    """Report that a worker has another version."""
    return f"{who} has vislam of code {code}, here it is {code_digest()}; install the same there"
