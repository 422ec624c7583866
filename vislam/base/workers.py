"""Processes that share runs of estimators: replaced when lost, and ended with the caller."""

import logging
import multiprocessing
import os
import signal
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from typing import Any, TypeVar

from vislam.base.errors import DivergedError, Interrupted, LostError

Job = TypeVar("Job")
Answer = TypeVar("Answer")
_log = logging.getLogger("vislam.base")
_HELD = {signal.SIGINT, signal.SIGTERM}
_MOST_LOSSES = 3
"""Losses after which no more workers are started: then it is not by chance."""
_MOST_LOSSES_ALONE = 2
"""Losses of a job that runs alone after which it is given up."""
_TICK = 0.2
"""Time between two looks at how far the jobs are [s]."""
_PATIENCE = 10.0
"""Time that jobs are given to come to an end after an interrupt [s]."""


@dataclass(frozen=True)
class _Board:
    """Shared memory of the caller and its workers.

    Attributes
    ----------
    counts : array of int
        How far the job in each place is.
    stop : int
        Whether all are to come to an end.
    """

    counts: Any
    stop: Any


@dataclass(frozen=True)
class _Running:
    index: int
    place: int


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
        self.processes, self._say = processes, say
        self._losses = 0
        self._running: dict[Future[Any], _Running] = {}
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

    def each(
        self,
        work: Callable[[Job], Answer],
        jobs: Sequence[Job],
        *,
        on_tick: Callable[[Mapping[int, int]], None] = lambda counts: None,
    ) -> Iterator[tuple[int, Answer | LostError]]:
        """Index and answer of each job, as they come; as many run at a time as there are processes.

        Jobs that ran when a process was lost are done again, one at a time, so that one whose process is
        lost whenever it runs is found, and given up, and takes no other with it.

        Parameters
        ----------
        work : callable
            May call :func:`advance`.
        jobs : sequence
        on_tick : callable
            Is given, now and then, how far the jobs that run are, by index.

        Yields
        ------
        (int, answer or LostError)
        """
        waiting, suspects = deque(range(len(jobs))), set[int]()
        losses = Counter[int]()
        while waiting or self._running:
            while waiting and len(self._running) < (1 if suspects else self.processes):
                self._begin_one(work, waiting[0], jobs)
                waiting.popleft()
            ended = wait(self._running, timeout=_TICK, return_when=FIRST_COMPLETED).done
            counts = self._board.counts
            on_tick({one.index: counts[one.place] for one in self._running.values()})
            if any(_is_lost(future) for future in ended):
                # The pool ends all of them.
                ended = wait(self._running).done
            lost = []
            for future in ended:
                index = self._running.pop(future).index
                if _is_lost(future):
                    lost.append(index)
                else:
                    suspects.discard(index)
                    yield index, future.result()
            if lost:
                self._restart("a worker process was lost; what ran is done again, one at a time")
                losses.update(lost if suspects else ())
                given_up = [index for index in lost if losses[index] >= _MOST_LOSSES_ALONE]
                waiting.extendleft(sorted(set(lost) - set(given_up), reverse=True))
                suspects = suspects.union(lost).difference(given_up)
                for index in given_up:
                    yield index, LostError("its process was lost whenever it ran, killed or out of memory")

    def stopped(self) -> Iterator[tuple[int, Any]]:
        """Index and answer of each job that :meth:`each` was at, after an interrupt.

        An Interrupted from :func:`advance` ends them; what does not answer in time is left out.
        """
        self._board.stop.value = 1
        for future in wait(self._running, timeout=_PATIENCE).done:
            if future.exception() is None:
                yield self._running.pop(future).index, future.result()

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
        self._board = _Board(context.RawArray("q", self.processes), context.RawValue("b", 0))
        self._pool = ProcessPoolExecutor(
            self.processes, mp_context=context, initializer=_begin, initargs=(self._reader, self._board)
        )

    def _begin_one(self, work: Callable[[Job], Answer], index: int, jobs: Sequence[Job]) -> None:
        """Hand a job to a process that has none, in a place of the board that is free."""
        taken = {one.place for one in self._running.values()}
        place = next(place for place in range(self.processes) if place not in taken)
        self._board.counts[place] = 0
        try:
            (future,) = self._submit(_in_place, [(work, place, jobs[index])])
        except BrokenProcessPool as lost:
            future = Future()
            future.set_exception(lost)
        self._running[future] = _Running(index, place)

    def _submit(self, work: Callable[[Job], Answer], jobs: Sequence[Job]) -> list[Future[Answer]]:
        # Ctrl-C reaches the whole group; a worker that is still importing would answer with a traceback.
        with _deferred_interrupt():
            before = set(multiprocessing.active_children())
            try:
                return [self._pool.submit(work, job) for job in jobs]
            finally:
                self._started |= set(multiprocessing.active_children()) - before

    def _replace(self) -> None:
        self._losses += 1
        if self._losses > _MOST_LOSSES:
            raise DivergedError(
                f"worker processes were lost {self._losses} times, killed or out of memory; "
                "use one process, or fewer frames"
            )
        self._restart(f"a worker process was lost; starting anew ({self._losses} of {_MOST_LOSSES})")

    def _restart(self, told: str) -> None:
        self.close()
        self._say(told)
        self._start()


_board: _Board | None = None
_place = 0
"""Of a worker: the board, and its job's place on it."""


def advance(count: int) -> None:
    """Report how far a job of :meth:`Workers.each` is, from within it; Interrupted if it is to end."""
    if _board is not None:
        _board.counts[_place] = count
        if _board.stop.value:
            raise Interrupted


def _in_place(job: tuple[Callable[[Job], Answer], int, Job]) -> Answer:
    global _place
    work, _place, given = job
    return work(given)


def _is_lost(future: Future[Any]) -> bool:
    return isinstance(future.exception(), BrokenProcessPool)


def _begin(lifeline: Connection, board: _Board) -> None:
    """Prepare a worker: interrupts are for the caller to answer, and it ends when its lifeline does."""
    global _board  # noqa: PLW0603
    _board = board
    for number in _HELD:
        signal.signal(number, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _HELD)
    threading.Thread(target=_watch, args=(lifeline,), daemon=True).start()


def _watch(lifeline: Connection) -> None:
    lifeline.poll(None)
    os._exit(1)


@contextmanager
def _deferred_interrupt() -> Iterator[None]:
    """Hold interrupts back from this thread, and from the processes that it starts.

    A pool that is interrupted between making its thread and starting it cannot be shut down. The mask is for
    the processes, which inherit it; it holds nothing back that another thread takes, such as those of BLAS,
    or that comes after multiprocessing has started its tracker, which lets interrupts through. So they are
    noted here, and raised in the end.
    """
    resource_tracker.ensure_running()
    held: list[int] = []
    main = threading.current_thread() is threading.main_thread()
    handlers = {number: signal.getsignal(number) for number in _HELD} if main else {}
    before: Any = signal.pthread_sigmask(signal.SIG_BLOCK, _HELD)
    try:
        for number in handlers:
            signal.signal(number, lambda number, _: held.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        if held:
            signal.raise_signal(held[0])
