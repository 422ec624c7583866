"""Likelihood of a config: the filter run over a repaired sequence with a frozen choice of observations."""

from collections.abc import Callable
from collections.abc import Sequence as Items
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from vislam.base.errors import DivergedError
from vislam.base.types import Array, BoolArray, IntArray
from vislam.base.workers import Workers
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config
from vislam.comparison.open import Dataset
from vislam.core.estimator import Problem
from vislam.core.run import Run
from vislam.estimators import loop
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.ekf.scores import INPUTS, Scores, levels
from vislam.estimators.ekf.state import JointState
from vislam.repair.inertial import Clock
from vislam.repair.pixels import DisparityOffset

_OPTIONS = EkfOptions(
    error="invariant", landmarks="anchored_uvd", marginalised_landmarks="filtered", track_errors="states"
)
"""The consistent filter, without the backward pass: only innovations are wanted."""
_SMOOTHED = EkfOptions(error="invariant", landmarks="anchored_uvd", smoothed=True)
"""As ``eks`` ships."""


@dataclass(frozen=True)
class Stretch:
    """Some frames of a recording.

    Attributes
    ----------
    begin, end : int
        From ``begin`` to before ``end``.
    state : JointState or None
        Of the filter before the first of them; None before the first of all.
    """

    begin: int
    end: int
    state: JointState | None = None


@dataclass(frozen=True)
class Gated:
    """The filter with its gate.

    Attributes
    ----------
    run : Run
    track : (m,)
        Tracks that have ended.
    matching_bias, variance : (m,)
        Their stereo-matching biases as the filter knows them, and the variances of these.
    halves : tuple of Stretch
        The whole recording, in two that do not wait for each other.
    """

    run: Run
    track: IntArray
    matching_bias: Array
    variance: Array
    halves: tuple[Stretch, ...]


@dataclass(frozen=True)
class Scored:
    """Log likelihood of each frame ``(T,)`` and its derivatives; minus infinity where the filter fails."""

    log_likelihood: Array
    scores: Scores


@dataclass(frozen=True)
class Evaluator:
    """Runs the filter for many configs at once; the observations are those of the repaired sequence.

    Attributes
    ----------
    dataset : Dataset
    base : Config
        The config that the sequence was repaired with.
    workers : Workers or None
        Processes to share the work.
    """

    dataset: Dataset
    base: Config
    workers: Workers | None = None

    def run(self, config: Config, *, usable: BoolArray | None = None) -> Run:
        """Run the filter; with ``usable (n,)`` given, that choice of observations replaces the gate."""
        return _filter(self._moved(config), config, usable)

    def gated(self, config: Config) -> Gated:
        """Run the filter with its gate, and ask for what it knows besides."""
        dataset = self._moved(config)
        solver = EkfEstimator(_problem(config, dataset), _OPTIONS)
        frames = len(dataset.sequence)
        middle, states = frames // 2, list[JointState]()

        def passed(k: int) -> None:
            if k + 1 == middle:
                states.append(solver.state.copy())

        run = _run(solver, dataset, config, None, on_frame=passed)
        parts = [Stretch(0, middle), *(Stretch(middle, frames, state) for state in states)]
        return Gated(run, *solver.matching_biases(), tuple(parts if states else [Stretch(0, frames)]))

    def levels(self, config: Config) -> Array:
        """Noise levels ``(LEVELS,)`` of a config that :meth:`scored` takes scores of."""
        return levels(_problem(config, self._moved(config)))

    def inputs(self, config: Config) -> Array:
        """What is recorded of the motion ``(T, INPUTS)``, as a config has it; zeros with raw inertia."""
        sequence = self._moved(config).sequence
        if config.motion == "imu":
            return np.zeros((len(sequence), INPUTS))
        return np.nan_to_num(np.column_stack(sequence.step_means()))

    def scored(
        self, config: Config, others: Items[Config], *, usable: BoolArray, stretches: Items[Stretch]
    ) -> tuple[Scored, list[Array]]:
        """Score a config by the backward pass, and the log likelihoods of others beside it.

        All are those of the frames of the stretches.
        """
        every = list(stretches)
        jobs = self._jobs([config, *others], usable, every)
        of_config = [replace(job, scored=True) for job in jobs[: len(every)]]
        answers = self.map(_answer, [*of_config, *jobs[len(every) :]])
        parts = answers[: len(every)]
        scores = Scores(
            np.concatenate([part.scores.levels for part in parts]),
            np.concatenate([part.scores.inputs for part in parts]),
        )
        found = Scored(np.concatenate([part.log_likelihood for part in parts]), scores)
        return found, _joined(answers[len(every) :], len(every))

    def log_likelihoods(self, configs: Items[Config], *, usable: BoolArray) -> list[Array]:
        """Log likelihood of each frame ``(T,)`` under each config; minus infinity where the filter fails."""
        whole = Stretch(0, len(self.dataset.sequence))
        return self.map(_answer, self._jobs(configs, usable, [whole]))

    def smoothed(self, configs: Items[Config]) -> list[tuple[Dataset, Run]]:
        """Run the smoothed filter with its gate for each config; each dataset is as its config has it."""
        return self.map(_smoothed, [(self._moved(config), config) for config in configs])

    def map(self, work: Callable[[Any], Any], jobs: Items[Any]) -> list[Any]:
        """Answers to jobs, by the processes that share the work."""
        return [work(job) for job in jobs] if self.workers is None else self.workers.map(work, jobs)

    def _jobs(self, configs: Items[Config], usable: BoolArray, stretches: Items[Stretch]) -> list["_Job"]:
        jobs = []
        for config in configs:
            dataset = self._moved(config)
            jobs += [_Job(dataset, config, usable, stretch) for stretch in stretches]
        return jobs

    def _moved(self, config: Config) -> Dataset:
        """Dataset with the clock and the disparities of a config, all other repairs as they were."""
        steps, old = config.data.repair, self.base.data.repair
        sequence = self.dataset.sequence
        if steps.clock is not None and steps.clock != old.clock:
            sequence = Clock(offset=steps.clock.offset).apply(sequence)
        if steps.disparity_offset is not None and steps.disparity_offset != old.disparity_offset:
            applied = 0.0 if old.disparity_offset is None else old.disparity_offset.pixels
            moved = DisparityOffset(pixels=steps.disparity_offset.pixels - applied)
            held = self.dataset.held_out
            held = None if held is None else moved.apply(held)
            return replace(self.dataset, sequence=moved.apply(sequence), held_out=held)
        return replace(self.dataset, sequence=sequence)


def _filter(dataset: Dataset, config: Config, usable: BoolArray | None) -> Run:
    solver = EkfEstimator(_problem(config, dataset), replace(_OPTIONS, gate=usable is None))
    return _run(solver, dataset, config, usable)


def _problem(config: Config, dataset: Dataset) -> Problem:
    """Problem of a config without its kernel: the likelihood is that of Gaussian innovations."""
    return replace(make_problem(config, dataset), kernel=None)


def _run(
    solver: EkfEstimator,
    dataset: Dataset,
    config: Config,
    usable: BoolArray | None,
    *,
    on_frame: Callable[[int], None] = lambda k: None,
) -> Run:
    return loop.run(
        solver,
        dataset.sequence,
        pixel_sigma(config, dataset),
        name="ekf",
        usable=usable,
        on_frame=on_frame,
        blas_threads=config.blas_threads,
    )


@dataclass(frozen=True)
class _Job:
    """The filter over a stretch; ``usable (n,)`` are the observations that are fused."""

    dataset: Dataset
    config: Config
    usable: BoolArray
    stretch: Stretch
    scored: bool = False


def _answer(job: _Job) -> Array | Scored:
    """Log likelihood of each frame of a stretch, and its derivatives where these are asked for."""
    stretch, many = job.stretch, len(job.dataset.sequence)
    options = replace(_OPTIONS, gate=False)
    solver = EkfEstimator(_problem(job.config, job.dataset), options, scored=job.scored)
    if stretch.state is not None:
        solver.state = stretch.state.copy()
    sigma = pixel_sigma(job.config, job.dataset)
    frames = job.dataset.sequence.frames(sigma, job.usable, begin=stretch.begin, end=stretch.end)
    found = Scores.none(many)
    with threadpool_limits(job.config.blas_threads), np.errstate():
        try:
            value = np.array([solver.process(frame).log_likelihood for frame in frames])
        except (DivergedError, np.linalg.LinAlgError):
            value = np.full(stretch.end - stretch.begin, -np.inf)
        else:
            found = solver.scores(many) if job.scored else found
    rows = slice(stretch.begin, stretch.end)
    return Scored(value, Scores(found.levels[rows], found.inputs[rows])) if job.scored else value


def _joined(parts: list[Array], each: int) -> list[Array]:
    """Arrays, so many consecutive ones concatenated each."""
    return [np.concatenate(parts[start : start + each]) for start in range(0, len(parts), each)]


def _smoothed(job: tuple[Dataset, Config]) -> tuple[Dataset, Run]:
    dataset, config = job
    solver = EkfEstimator(_problem(config, dataset), _SMOOTHED)
    return dataset, _run(solver, dataset, config, None)
