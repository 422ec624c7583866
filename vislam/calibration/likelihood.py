"""Likelihood of a config: the filter run over a repaired sequence with a frozen choice of observations."""

from collections.abc import Callable
from collections.abc import Sequence as Items
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dtrsv
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
from vislam.estimators.ekf.linear import Correction
from vislam.repair.inertial import Clock
from vislam.repair.pixels import DisparityOffset

_OPTIONS = EkfOptions(
    error="invariant", landmarks="anchored_uvd", marginalised_landmarks="filtered", track_errors="states"
)
"""The consistent filter, without the backward pass: only innovations are wanted."""
_SMOOTHED = EkfOptions(error="invariant", landmarks="anchored_uvd", smoothed=True)
"""As ``eks`` ships."""
_PROBES = 24
"""Random directions of a measurement in which covariances are compared: 276 pairs."""


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
    """

    run: Run
    track: IntArray
    matching_bias: Array
    variance: Array


@dataclass(frozen=True)
class Beside:
    """The filter with a config, and with others that differ little from it.

    Attributes
    ----------
    log_likelihood : (T,)
        Of each frame with the config.
    moved : (T, p)
        With each of the others.
    information : (p, p)
        What of their predictions is another, as twice the divergence: with innovations ``v`` of covariance
        ``S``, ``dv^T S^-1 dv + tr(S^-1 dS S^-1 dS) / 2`` over all frames.
    """

    log_likelihood: Array
    moved: Array
    information: Array


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
        run = _run(solver, dataset, config, None)
        return Gated(run, *solver.matching_biases())

    def log_likelihoods(self, configs: Items[Config], *, usable: BoolArray) -> list[Array]:
        """Log likelihood of each frame ``(T,)`` under each config; minus infinity where the filter fails."""
        return [
            one.log_likelihood for one in self.map(_answer, [self._job([one], usable) for one in configs])
        ]

    def beside(self, config: Config, others: Items[Config], *, usable: BoolArray) -> Beside:
        """Run the filter with a config and others that differ little from it.

        The processes share the others; each has its own filter with the config, which gives the same.
        """
        many = 1 if self.workers is None else min(self.workers.processes, len(others))
        parts = [list(part) for part in np.array_split(np.arange(len(others)), many)]
        jobs = [self._job([config, *(others[index] for index in part)], usable) for part in parts]
        found = self.map(_answer, jobs)
        whitened = np.hstack([one.whitened for one in found])
        sketch = np.hstack([one.sketch for one in found])
        return Beside(
            found[0].log_likelihood,
            np.hstack([one.moved for one in found]),
            whitened.T @ whitened + sketch.T @ sketch,
        )

    def smoothed(self, configs: Items[Config]) -> list[tuple[Dataset, Run]]:
        """Run the smoothed filter with its gate for each config; each dataset is as its config has it."""
        return self.map(_smoothed, [(self._moved(config), config) for config in configs])

    def map(self, work: Callable[[Any], Any], jobs: Items[Any]) -> list[Any]:
        """Answers to jobs, by the processes that share the work."""
        return [work(job) for job in jobs] if self.workers is None else self.workers.map(work, jobs)

    def _job(self, configs: Items[Config], usable: BoolArray) -> "_Job":
        return _Job([(self._moved(config), config) for config in configs], usable)

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


def _run(solver: EkfEstimator, dataset: Dataset, config: Config, usable: BoolArray | None) -> Run:
    return loop.run(
        solver,
        dataset.sequence,
        pixel_sigma(config, dataset),
        name="ekf",
        usable=usable,
        blas_threads=config.blas_threads,
    )


@dataclass(frozen=True)
class _Job:
    """The filter with some configs, frame by frame; ``usable (n,)`` are the observations that are fused."""

    configs: list[tuple[Dataset, Config]]
    usable: BoolArray


@dataclass(frozen=True)
class _Answer:
    """Log likelihoods of the first config and of the others, and how these differ from it.

    Attributes
    ----------
    log_likelihood : (T,)
    moved : (T, p)
    whitened : (N, p)
        By how much the innovations differ, of all N rows, in units of their standard deviation.
    sketch : (M, p)
        Numbers whose inner products are those of what the covariances differ by, on average.
    """

    log_likelihood: Array
    moved: Array
    whitened: Array
    sketch: Array


def _answer(job: _Job) -> _Answer:
    """Run the filters of a job side by side."""
    solvers, frames = [], []
    for dataset, config in job.configs:
        options = replace(_OPTIONS, gate=False)
        solvers.append(EkfEstimator(_problem(config, dataset), options, noted=len(job.configs) > 1))
        frames.append(dataset.sequence.frames(pixel_sigma(config, dataset), job.usable))
    values, whitened, sketch = [], list[Array](), list[Array]()
    (dataset, config), others = job.configs[0], len(solvers) - 1
    with threadpool_limits(config.blas_threads), np.errstate():
        try:
            for at_once in zip(*frames, strict=True):
                values.append(
                    [one.process(frame).log_likelihood for one, frame in zip(solvers, at_once, strict=True)]
                )
                if others:
                    first, *rest = (_corrections(one) for one in solvers)
                    generator = np.random.default_rng(at_once[0].k)
                    for update, *moved in zip(first, *rest, strict=True):
                        found = _differences(update, moved, generator)
                        whitened.append(found[0])
                        sketch.append(found[1])
        except (DivergedError, np.linalg.LinAlgError):
            values = [[-np.inf] * len(solvers)] * len(dataset.sequence)
    log_likelihood, none = np.array(values), np.zeros((0, others))
    return _Answer(
        log_likelihood[:, 0],
        log_likelihood[:, 1:],
        np.concatenate([none, *whitened]),
        np.concatenate([none, *sketch]),
    )


def _corrections(solver: EkfEstimator) -> list[Correction]:
    """Corrections of the last frame."""
    steps = solver.state.steps
    assert steps is not None
    return [one for one in steps if isinstance(one, Correction)]


def _differences(
    first: Correction, others: list[Correction], generator: np.random.Generator
) -> tuple[Array, Array]:
    """By what the predictions of a measurement differ from a first one.

    Returns
    -------
    whitened : (m, p)
        ``L^-1 (v_i - v)`` of innovations v, where ``L L^T`` is the first one's covariance S.
    sketch : (M, p)
        ``z^T L^-1 (S_i - S) L^-T z'`` for pairs of independent standard normal z. Products of these are
        traces of products on average, so inner products of columns are
        ``tr(S^-1 (S_i - S) S^-1 (S_j - S)) / 2``, without a matrix for each.
    """
    innovation, root = first.predicted()
    moved = [one.predicted() for one in others]
    probes = generator.standard_normal((len(innovation), _PROBES))
    # One at a time, so that what each is does not depend on which others come along.
    whitened = np.column_stack([dtrsv(root, value - innovation, lower=1) for value, _ in moved])
    directions = solve_triangular(root, probes, lower=True, trans=1, check_finite=False)
    own, pairs = probes.T @ probes, np.triu_indices(_PROBES, 1)
    sketch = np.empty((len(pairs[0]), len(others)))
    for column, (_, factor) in enumerate(moved):
        seen = factor.T @ directions
        sketch[:, column] = (seen.T @ seen - own)[pairs]
    return whitened, sketch / np.sqrt(2.0 * len(pairs[0]))


def _smoothed(job: tuple[Dataset, Config]) -> tuple[Dataset, Run]:
    dataset, config = job
    solver = EkfEstimator(_problem(config, dataset), _SMOOTHED)
    return dataset, _run(solver, dataset, config, None)
