"""Processes that share runs of estimators: replaced when lost, and ended with the caller."""

import logging
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from vislam.base.errors import DivergedError

Job = TypeVar("Job")
Answer = TypeVar("Answer")
_log = logging.getLogger("vislam.base")
_HELD = {signal.SIGINT, signal.SIGTERM}
_MOST_LOSSES = 3
"""Losses after which no more workers are started: then it is not by chance."""


class Workers:
    """Processes that jobs are handed to.

    Parameters
    ----------
    processes : int
        How many.
    say : callable
        Is given a line when some were lost.
    """

    def __init__(self, processes: int, *, say: Callable[[str], None] = _log.warning) -> None:
        self._processes, self._say = processes, say
        self._losses = 0
        self._start()

    def map(self, work: Callable[[Job], Answer], jobs: Sequence[Job]) -> list[Answer]:
        """Answers to jobs, in their order; a job whose process was lost is done again.

        Raises
        ------
        DivergedError
            If processes are lost again and again.
        """
        answers: dict[int, Answer] = {}
        while True:
            left = [index for index in range(len(jobs)) if index not in answers]
            try:
                for index, future in zip(left, self._submit(work, [jobs[k] for k in left]), strict=True):
                    answers[index] = future.result()
                return [answers[index] for index in range(len(jobs))]
            except BrokenProcessPool:
                self._replace()

    def close(self) -> None:
        """End the processes, whatever they are doing.

        One that was being started when the others were lost is not among those that the pool ends, and while
        it lives, the pool waits for it to take its job.
        """
        self._lifeline.close()
        for process in self._started:
            process.kill()
        self._pool.shutdown(cancel_futures=True)
        self._reader.close()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        # What ends the workers is the end of this pipe: closed here, or by the death of this process.
        self._reader, self._lifeline = context.Pipe(duplex=False)
        self._started: set[BaseProcess] = set()
        self._pool = ProcessPoolExecutor(
            self._processes, mp_context=context, initializer=_begin, initargs=(self._reader,)
        )

    def _submit(self, work: Callable[[Job], Answer], jobs: Sequence[Job]) -> list[Future[Answer]]:
        # Ctrl-C reaches the whole group; a worker that is still importing would answer with a traceback.
        with _deferred_interrupt():
            before = set(multiprocessing.active_children())
            try:
                return [self._pool.submit(work, job) for job in jobs]
            finally:
                self._started |= set(multiprocessing.active_children()) - before

    def _replace(self) -> None:
        self.close()
        self._losses += 1
        if self._losses > _MOST_LOSSES:
            raise DivergedError(
                f"worker processes were lost {self._losses} times, killed or out of memory; "
                "use one process, or fewer frames"
            )
        self._say(f"a worker process was lost; starting anew ({self._losses} of {_MOST_LOSSES})")
        self._start()


def _begin(lifeline: Connection) -> None:
    """Prepare a worker: Ctrl-C is for the caller to answer, and the worker ends when its lifeline does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _HELD)
    threading.Thread(target=_watch, args=(lifeline,), daemon=True).start()


def _watch(lifeline: Connection) -> None:
    lifeline.poll(None)
    os._exit(1)


@contextmanager
def _deferred_interrupt() -> Iterator[None]:
    """Hold interrupts back from this thread, and from the processes that it starts.

    A pool that is interrupted between making its thread and starting it cannot be shut down.
    """
    before: Any = signal.pthread_sigmask(signal.SIG_BLOCK, _HELD)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
