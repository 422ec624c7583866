"""Runs of a comparison at the same time, each in a process of its own; their results are the same."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import TracebackType

from vislam.base.errors import LostError
from vislam.base.progress import Progress
from vislam.base.workers import Workers, advance
from vislam.comparison.job import Job
from vislam.core.run import Run
from vislam.estimators import loop


class SideBySide:
    """Runs that share the cores; a context, at whose end no process is left.

    Parameters
    ----------
    jobs : sequence of Job
    processes : int
        How many run at a time, at most.
    progress : Progress
        Shows how many frames of all are done, and is told of lost processes.
    """

    def __init__(self, jobs: Sequence[Job], processes: int, progress: Progress) -> None:
        self._jobs, self._progress = jobs, progress
        self._beside = min(processes, len(jobs)) - 1
        self._workers = Workers(self._beside + 1, say=progress.note)

    def __enter__(self) -> "SideBySide":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._workers.close()

    def finished(self) -> Iterator[Run]:
        """Runs as they end, complete or not; one whose process is lost whenever it runs has no frames."""
        jobs = self._jobs
        done = [0] * len(jobs)
        title = f"{', '.join(job.name for job in jobs)}, {self._beside + 1} at a time"
        with self._progress.bar(title, sum(len(job.sequence) for job in jobs)) as bar:

            def on_tick(counts: Mapping[int, int]) -> None:
                for index, count in counts.items():
                    done[index] = count
                bar.done(sum(done))

            for index, answer in self._workers.each(_run, jobs, on_tick=on_tick):
                job = jobs[index]
                done[index] = len(job.sequence)
                if isinstance(answer, LostError):
                    yield loop.not_run(job.name, job.sequence, answer)
                else:
                    yield self._marked(answer)

    def stopped(self) -> Iterator[Run]:
        """What those had done that ran when it was interrupted, as far as they say so in time."""
        for _, run in self._workers.stopped():
            yield self._marked(run)

    def _marked(self, run: Run) -> Run:
        return replace(run, cost=replace(run.cost, beside=self._beside))


def _run(job: Job) -> Run:
    """Do a job in a worker; one that is to stop gives back what it has done."""
    try:
        return job.run(lambda k: advance(k + 1))
    except loop.RunInterrupted as stop:
        return stop.run
