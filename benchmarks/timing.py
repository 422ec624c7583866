"""What all parts share: a drive that is ready to run, a filter timed over it, a part's printed table."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.calibration.likelihood import first_frames
from vislam.comparison import config as configuration
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config
from vislam.comparison.open import Dataset, open_dataset
from vislam.core.estimator import Problem
from vislam.estimators import ekf
from vislam.estimators.ekf import EkfEstimator, EkfOptions

MEMBERS: Mapping[str, EkfOptions] = {name: EkfOptions(**ekf.MEMBERS[name]) for name in ("ekf", "eks")}
"""The members that are timed: the standard filter, and the one that takes the most steps back."""


@dataclass(frozen=True)
class Part:
    """What one part of the benchmark found.

    Attributes
    ----------
    title : str
    header, rows
        The table that is printed.
    notes : tuple of str
        Lines below it.
    values : dict
        The same numbers, plain, for the JSON.
    """

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: tuple[str, ...]
    values: dict[str, Any]


@dataclass(frozen=True)
class Drive:
    """A repaired sequence with the config that says how it is to be filtered."""

    config: Config
    dataset: Dataset

    @classmethod
    def open(cls, config: Path | Config, *, data_dir: Path | None = None) -> "Drive":
        """Read or simulate the data of a config, given as itself or as its file."""
        if isinstance(config, Path):
            config = configuration.load(config)
        return cls(config, open_dataset(config.data, seed=config.seed, data_dir=data_dir))

    @property
    def name(self) -> str:
        """Name of the sequence, marked where a simulation stands in for it."""
        sequence = self.dataset.sequence
        return f"{sequence.name} [SIMULATED]" if sequence.stand_in else sequence.name

    @cached_property
    def problem(self) -> Problem:
        """What the filters are built from."""
        return make_problem(self.config, self.dataset)

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of each observation's (uL, uR, v), ``(n, 3)`` [px]."""
        return pixel_sigma(self.config, self.dataset)

    def first(self, frames: int) -> "Drive":
        """Return the first frames of the drive."""
        return replace(
            self, dataset=replace(self.dataset, sequence=first_frames(self.dataset.sequence, frames))
        )

    def thinned(self, keep: BoolArray) -> "Drive":
        """Return the drive with the observations of a mask only."""
        return replace(self, dataset=replace(self.dataset, sequence=self.dataset.sequence.select(keep)))


@dataclass(frozen=True)
class FrameSizes:
    """How many landmarks a filter had to do with at a frame.

    Attributes
    ----------
    held : int
        In the state before it.
    known : int
        Of these, seen in it; the others leave.
    fused : int
        Of the known, not refused by the gate.
    new : int
        Appended.
    """

    held: int
    known: int
    fused: int
    new: int


@dataclass(frozen=True)
class Timed:
    """A filter's run over a drive.

    Attributes
    ----------
    step_time : (T,)
        [s].
    backward : float
        Time of the final estimate [s].
    memory : int
        Most that was held for the backward pass [bytes].
    sizes : list of FrameSizes
    dimension : (T,)
        Size of the state's error after each frame.
    """

    step_time: Array
    backward: float
    memory: int
    sizes: list[FrameSizes]
    dimension: IntArray

    @property
    def forward(self) -> float:
        """Time of all steps [s]."""
        return float(self.step_time.sum())


def timed(drive: Drive, options: EkfOptions, *, clock: Callable[[], float] = time.thread_time) -> Timed:
    """Run a filter over a drive, there and back; what its steps return is not kept.

    The clock is the thread's own, to which other work on the machine adds little; where there are more
    threads than one it has to be another.
    """
    solver = EkfEstimator(drive.problem, options)
    state, recorder = solver.state, solver._recorder
    times: list[float] = []
    sizes: list[FrameSizes] = []
    dimension: list[int] = []
    for frame in drive.dataset.sequence.frames(drive.sigma):
        refused = np.zeros(len(frame.track), bool)
        held, known = len(state.track), int(np.isin(state.track, frame.track).sum())
        before = clock()
        record = solver.process(frame, refused)
        times.append(clock() - before)
        fused = record.dof // 3
        assert record.used is not None
        sizes.append(FrameSizes(held, known, fused, int(record.used.sum()) - fused))
        dimension.append(len(state.cov))
    before = clock()
    solver.finalize()
    return Timed(
        step_time=np.array(times),
        backward=clock() - before,
        memory=0 if recorder is None else recorder.peak,
        sizes=sizes,
        dimension=np.array(dimension),
    )


def quickest(runs: Sequence[Timed]) -> Timed:
    """Least times of equal runs, step by step: what else the machine did is in none of them."""
    return replace(
        runs[0],
        step_time=np.min([run.step_time for run in runs], axis=0),
        backward=min(run.backward for run in runs),
    )


def milliseconds(seconds: float) -> str:
    """Text of a time in milliseconds."""
    return f"{1e3 * seconds:.2f}"
