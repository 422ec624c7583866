"""How the runs of a comparison change with what is varied about them: one more run for each variation.

Consider covariance (S. F. Schmidt, *Application of State-Space Methods to Navigation Problems*, Advances in
Control Systems 3, 1966; G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation*, 1977,
chapter VIII): an estimator that keeps to nominal parameters errs by the noise that it knows of and, to first
order, by its sensitivity to the parameters times what these are off by. The sensitivity of any estimator is
a difference quotient: it runs again with one component taken for a standard deviation larger, on the same
observations, without a gate of its own.

Sandwich (P. J. Huber, *The Behavior of Maximum Likelihood Estimates under Nonstandard Conditions*, 1967;
H. White, *Maximum Likelihood Estimation of Misspecified Models*, Econometrica 1982): where weighted scores
``sum_b w_b g_b(x) = 0`` define an estimate, ``dx/dw_b = A^-1 g_b`` with A the information, so that the sum of
the squares of these derivatives over blocks b is ``A^-1 (sum g_b g_b^T) A^-1``: the infinitesimal jackknife
(L. A. Jaeckel, Bell Laboratories 1972). An estimator's derivative by the weight of a block is a difference
quotient as well: the block's pixel noise is stated larger.
"""

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from vislam.base.errors import ConfigError
from vislam.base.progress import Progress
from vislam.base.types import Array, BoolArray
from vislam.base.workers import Workers
from vislam.comparison.config import Config
from vislam.comparison.job import Job
from vislam.core import sequence as data
from vislam.core.changes import Changes, changes
from vislam.core.estimator import Problem
from vislam.core.moved_data import component_name, moved
from vislam.core.run import Beside, Run
from vislam.core.trajectory import Poses
from vislam.models import shared_errors

_STEP = 0.2
"""By how much the weight of a block is made smaller: its variances are divided by the rest."""


@dataclass(frozen=True)
class Given:
    """What a comparison gives to all of its runs.

    Attributes
    ----------
    config : Config
    problem : Problem
    sequence : Sequence
    sigma : (n, 3)
        Standard deviation of each observation's (uL, uR, v) [px].
    """

    config: Config
    problem: Problem
    sequence: data.Sequence
    sigma: Array


@dataclass(frozen=True)
class _Variation:
    """What is varied about a run, and by how much its change is to be multiplied."""

    kind: Beside
    cause: str
    sequence: data.Sequence
    sigma: Array
    factor: float


@dataclass(frozen=True)
class _Answer:
    """Poses of a varied run, or why there are none, and its time [s]."""

    filtered: Poses
    smoothed: Poses | None
    error: str
    seconds: float


def refuse_doubled(config: Config, problem: Problem) -> None:
    """Raise ConfigError where a parameter is estimated and considered: its error would count twice."""
    estimated = problem.shared()
    for name, _, sigma in config.consider.components():
        if name in estimated:
            key = f"noise.{shared_errors.prior_name(name)} = {estimated[name].sigma:g}"
            raise ConfigError(
                f"consider.{name}: expected 0, as {key} has it estimated, got {sigma:g}; set one of them to 0"
            )


def wanted(config: Config) -> bool:
    """Whether a config asks for anything beside the estimators' own covariances."""
    return config.sandwich is not None or next(config.consider.components(), None) is not None


def considered(
    runs: Mapping[str, Run],
    given: Given,
    *,
    usable: Mapping[str, BoolArray],
    processes: int,
    progress: Progress,
) -> Iterator[Run]:
    """Repeat runs with all variations, and give each back with its changes, in their order.

    A run without covariances, or that is incomplete, is left as it is. One of which a varied run fails has an
    event that says so in place of the changes.

    Parameters
    ----------
    runs : mapping of name to Run
    given : Given
    usable : mapping of name to (n,)
        Which observations each run was given.
    processes : int
        That share the work.
    progress : Progress
    """
    variations = tuple(_variations(given))
    workers = Workers(processes, say=progress.note) if processes > 1 else None
    try:
        for name, run in runs.items():
            if not run.complete or not _has_covariances(run) or _has_all(run, variations):
                continue
            jobs = [_job(run, given, usable[name], variation) for variation in variations]
            answers = []
            with progress.bar(f"{name}, considered", len(jobs)) as bar:
                for start in range(0, len(jobs), processes):
                    some = jobs[start : start + processes]
                    answers += list(map(_answer, some)) if workers is None else workers.map(_answer, some)
                    bar.done(len(answers))
            yield _with_changes(run, variations, answers)
    finally:
        if workers is not None:
            workers.close()


def _variations(given: Given) -> Iterator[_Variation]:
    config, sequence, sigma = given.config, given.sequence, given.sigma
    for name, index, amount in config.consider.components():
        other = moved(sequence, name, index=index, amount=amount)
        yield _Variation("considered", component_name(name, index), other, sigma, 1.0)
    if config.sandwich is not None:
        edges = np.linspace(0, len(sequence), config.sandwich.blocks + 1).round().astype(int)
        block = np.searchsorted(edges, sequence.frame_of, side="right") - 1
        for index, (first, after) in enumerate(pairwise(edges)):
            less = np.where(block == index, 1.0 / np.sqrt(1.0 - _STEP), 1.0)[:, None] * sigma
            yield _Variation("sandwich", f"frames_{first}_{after - 1}", sequence, less, 1.0 / _STEP)


def _has_covariances(run: Run) -> bool:
    return any(bool(np.isfinite(run.poses(one).covariances).any()) for one in run.estimates)


def _has_all(run: Run, variations: Sequence[_Variation]) -> bool:
    """Whether a run, from an earlier start, has all changes already."""
    return set(run.beside) == {variation.kind for variation in variations}


def _job(run: Run, given: Given, usable: BoolArray, variation: _Variation) -> Job:
    config = given.config
    # What a run itself rejected stays out, and it rejects nothing more: the rest would be another problem.
    problem = replace(given.problem, rig=variation.sequence.rig.copy(), gate_probability=1.0, lags=None)
    return Job(
        run.name,
        config.estimators[run.name],
        problem,
        variation.sequence,
        variation.sigma,
        usable & ~run.gated,
        config.blas_threads,
    )


def _answer(job: Job) -> _Answer:
    """Do a job; whatever fails is reported."""
    started = time.perf_counter()
    run = job.run()
    return _Answer(run.filtered, run.smoothed, run.log.error, time.perf_counter() - started)


def _with_changes(run: Run, variations: Sequence[_Variation], answers: Sequence[_Answer]) -> Run:
    """Run with the changes by each kind of variation, or with the reason why there are none."""
    for kind in dict.fromkeys(variation.kind for variation in variations):
        pairs = [pair for pair in zip(variations, answers, strict=True) if pair[0].kind == kind]
        broken = next((f"{one.cause}: {answer.error}" for one, answer in pairs if answer.error), "")
        if broken:
            told = f"no {kind} covariances, as a run for them is incomplete: {broken}"
            run = replace(run, log=replace(run.log, events=(*run.log.events, told)))
            continue
        run = run.with_changes(kind, _packed(run, pairs))
    return run


def _packed(run: Run, pairs: Sequence[tuple[_Variation, _Answer]]) -> Changes:
    after = run.smoothed
    return Changes(
        tuple(one.cause for one, _ in pairs),
        np.array([one.factor * changes(run.filtered, answer.filtered) for one, answer in pairs]),
        None
        if after is None
        else np.array(
            [one.factor * changes(after, answer.smoothed or answer.filtered) for one, answer in pairs]
        ),
        float(sum(answer.seconds for _, answer in pairs)),
    )
