"""Likelihood of a config: the filter run over a repaired sequence with a frozen choice of observations."""

from collections.abc import Sequence as Items
from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.base.workers import Workers
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config
from vislam.comparison.open import Dataset
from vislam.core.estimator import Problem
from vislam.core.run import Run
from vislam.estimators import loop
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.repair.inertial import Clock
from vislam.repair.pixels import DisparityOffset

_OPTIONS = EkfOptions(
    error="invariant", landmarks="anchored_uvd", marginalised_landmarks="filtered", track_errors="states"
)
"""The consistent filter, without the backward pass: only innovations are wanted."""
_SMOOTHED = EkfOptions(error="invariant", landmarks="anchored_uvd", smoothed=True)
"""As ``eks`` ships."""


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

    def smoothed(self, config: Config) -> tuple[Dataset, Run]:
        """Run the smoothed filter, with its gate; the dataset is as the config has it."""
        dataset = self._moved(config)
        solver = EkfEstimator(_problem(config, dataset), _SMOOTHED)
        return dataset, _run(solver, dataset, config, None)

    def matching_biases(self, config: Config) -> tuple[IntArray, Array, Array]:
        """Match errors of the tracks that ended and their variances, as the gated filter knows them."""
        dataset = self._moved(config)
        solver = EkfEstimator(_problem(config, dataset), _OPTIONS)
        _run(solver, dataset, config, None)
        return solver.matching_biases()

    def log_likelihoods(self, configs: Items[Config], *, usable: BoolArray) -> list[Array]:
        """Log likelihood of each frame ``(T,)`` under each config; minus infinity where the filter fails."""
        jobs = [(self._moved(config), config, usable) for config in configs]
        if self.workers is None:
            return [_log_likelihood(job) for job in jobs]
        return self.workers.map(_log_likelihood, jobs)

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
    sigma = pixel_sigma(config, dataset)
    return loop.run(
        solver, dataset.sequence, sigma, name="ekf", usable=usable, blas_threads=config.blas_threads
    )


def _log_likelihood(job: tuple[Dataset, Config, BoolArray]) -> Array:
    run = _filter(*job)
    return run.innovations.log_likelihood if run.complete else np.full(run.frames_expected, -np.inf)
