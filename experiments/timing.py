"""What all experiments share: a drive that is ready to run, a timed filter, and how a table is told."""

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_info

from vislam.base.files import replace_whole
from vislam.base.types import Array, BoolArray
from vislam.cli.console import Terminal
from vislam.comparison import config as configuration
from vislam.comparison.compare import make_problem, pixel_sigma
from vislam.comparison.config import Config
from vislam.comparison.open import Dataset, open_dataset
from vislam.comparison.provenance import provenance
from vislam.core.estimator import Problem
from vislam.core.sequence import Sequence as Recording
from vislam.estimators.ekf import EkfEstimator, EkfOptions

CONFIGS = Path(__file__).parents[1] / "configs"


@dataclass(frozen=True)
class Part:
    """What one part of an experiment found.

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


def tell(parts: Mapping[str, Callable[[], Part]], *, out: Path | None) -> None:
    """Measure the parts one after the other, print each, and write them all to ``out``."""
    terminal = Terminal()
    libraries = [item for item in threadpool_info() if item["user_api"] == "blas"]
    blas = sorted(f"{item['internal_api']} {item['version']} {item['architecture']}" for item in libraries)
    machine = {**provenance(), "blas": ", ".join(blas)}
    for key, value in machine.items():
        terminal.note(f"{key}: {value}")
    found = {}
    for name, measure in parts.items():
        part = measure()
        terminal.rows(part.header, part.rows, title=part.title)
        for note in part.notes:
            terminal.note(note)
        found[name] = {"title": part.title, **part.values}
    if out is not None:
        document = {"provenance": machine, "parts": found}
        with replace_whole(out) as temporary:
            temporary.write_text(json.dumps(document, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        terminal.note(f"numbers: {out}")


@dataclass(frozen=True)
class Drive:
    """A repaired sequence with the config that says how it is to be estimated."""

    config: Config
    dataset: Dataset

    @classmethod
    def open(cls, config: Path | Config, *, data_dir: Path | None = None) -> "Drive":
        """Read or simulate the data of a config, given as itself or as its file."""
        if isinstance(config, Path):
            config = configuration.load(config)
        return cls(config, open_dataset(config.data, seed=config.seed, data_dir=data_dir))

    @property
    def sequence(self) -> Recording:
        """The repaired sequence."""
        return self.dataset.sequence

    @property
    def name(self) -> str:
        """Name of the sequence, marked where a simulation stands in for it."""
        return self.sequence.name + (" [SIMULATED]" if self.sequence.synthetic else "")

    @cached_property
    def problem(self) -> Problem:
        """What the estimators are built from."""
        return make_problem(self.config, self.dataset)

    @cached_property
    def sigma(self) -> Array:
        """Standard deviation of each observation's (uL, uR, v), ``(n, 3)`` [px]."""
        return pixel_sigma(self.config, self.dataset)

    def first(self, frames: int) -> "Drive":
        """Return the first frames of the drive."""
        return self._with(self.sequence.first(frames))

    def thinned(self, keep: BoolArray) -> "Drive":
        """Return the drive with the observations of a mask only."""
        return self._with(self.sequence.select(keep))

    def _with(self, sequence: Recording) -> "Drive":
        return replace(self, dataset=replace(self.dataset, sequence=sequence))


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
    sizes : list of FrameSizes
    """

    step_time: Array
    backward: float
    sizes: list[FrameSizes]

    @property
    def forward(self) -> float:
        """Time of all steps [s]."""
        return float(self.step_time.sum())


def timed(drive: Drive, options: EkfOptions) -> Timed:
    """Run a filter over a drive, forward-backward, by the clock of the one thread that works."""
    solver = EkfEstimator(drive.problem, options)
    times: list[float] = []
    sizes: list[FrameSizes] = []
    for frame in drive.sequence.frames(drive.sigma):
        track = solver.state.track
        held, known = len(track), int(np.isin(track, frame.stereo.track).sum())
        before = time.thread_time()
        record = solver.process(frame)
        times.append(time.thread_time() - before)
        fused = record.dof // 3
        assert record.used is not None
        sizes.append(FrameSizes(held, known, fused, int(record.used.sum()) - fused))
    before = time.thread_time()
    solver.finalize()
    return Timed(np.array(times), time.thread_time() - before, sizes)


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
