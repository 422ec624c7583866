"""Part ``gtsam``: how much of the time of iSAM2's steps goes by inside GTSAM's solver."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np
from threadpoolctl import threadpool_limits

from experiments.timing import Drive, Part, milliseconds
from vislam.base.types import Array
from vislam.core.step import Final
from vislam.estimators.smoother import SmootherEstimator, SmootherOptions, engine, tree

RUNS = {
    "isam2": SmootherOptions(),
    "isam2, marginals: all": SmootherOptions(marginals="all"),
}


@dataclass
class Inside:
    """Time that went by inside calls [s]."""

    seconds: float = 0.0

    def counting(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """Return the same call, its time counted."""

        def counted(*arguments: Any) -> Any:
            before = time.thread_time()
            try:
                return call(*arguments)
            finally:
                self.seconds += time.thread_time() - before

        return counted


@dataclass(frozen=True)
class Smoothed:
    """A smoother's run over a drive.

    Attributes
    ----------
    step_time, solver_time : (T,)
        Of each step, and of what of it goes by inside GTSAM's solver: its updates and the reading of poses,
        twists and points. Building the factors is outside, though GTSAM's constructors do it [s].
    final_time : float
        Of the final estimate [s].
    final : Final
    """

    step_time: Array
    solver_time: Array
    final_time: float
    final: Final

    @property
    def outside(self) -> float:
        """Share of the steps' time outside GTSAM's solver."""
        return 1.0 - float(self.solver_time.sum() / self.step_time.sum())

    @property
    def last_of_first(self) -> float:
        """Mean time of the last tenth of the steps over that of the first."""
        tenths = np.array_split(self.step_time, 10)
        return float(tenths[-1].mean() / tenths[0].mean())


def smoothed(
    drive: Drive, options: SmootherOptions, *, on_frame: Callable[[int], None] = lambda k: None
) -> Smoothed:
    """Run a smoother over a drive, with one thread, whose own clock it is."""
    solver = SmootherEstimator(drive.problem, options)
    step_time, solver_time = [], []
    with threadpool_limits(1), _counted() as inside:
        for frame in drive.sequence.frames(drive.sigma):
            inside.seconds = 0.0
            before = time.thread_time()
            solver.process(frame)
            step_time.append(time.thread_time() - before)
            solver_time.append(inside.seconds)
            on_frame(frame.k)
        before = time.thread_time()
        final = solver.finalize()
        final_time = time.thread_time() - before
    return Smoothed(np.array(step_time), np.array(solver_time), final_time, final)


@contextmanager
def _counted() -> Iterator[Inside]:
    """Count the time inside GTSAM's solver."""
    inside = Inside()
    kind = engine.WholeGraph
    with (
        patch(f"{engine.__name__}.solved", inside.counting(tree.solved)),
        patch(f"{tree.__name__}.solved", inside.counting(tree.solved)),
        patch.object(kind, "points", inside.counting(kind.points)),
    ):
        yield inside


def inside_gtsam(drive: Drive) -> Part:
    """Run each smoother once over a drive, with all tracks."""
    runs = {name: smoothed(drive, options) for name, options in RUNS.items()}
    return Part(
        title=f"gtsam: {drive.name}, {len(drive.sequence)} frames, 1 thread",
        header=["run", "step, mean [ms]", "outside GTSAM", "last tenth/first", "final/steps", "recoveries"],
        rows=[
            [
                name,
                milliseconds(run.step_time.mean()),
                f"{100 * run.outside:.0f} %",
                f"{run.last_of_first:.2f}",
                f"{run.final_time / run.step_time.sum():.2f}",
                f"{run.final.counts['recoveries']}",
            ]
            for name, run in runs.items()
        ],
        notes=("outside: all but GTSAM's updates and the reading of its estimates",),
        values={
            name: {"outside_share": run.outside, "last_tenth_ratio": run.last_of_first}
            for name, run in runs.items()
        },
    )
