"""One run of an estimator such that any process can do it: what it is built from, and what it is fed."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from vislam.base.types import Array, BoolArray
from vislam.comparison.members import Unbuilt, member
from vislam.core.estimator import Problem
from vislam.core.run import Run
from vislam.core.sequence import Sequence
from vislam.estimators import loop


@dataclass(frozen=True)
class Job:
    """A run that is to be done.

    Attributes
    ----------
    name : str
    section : mapping of str to Any
        What stands under ``estimators.<name>``.
    problem : Problem
    sequence : Sequence
    sigma : (n, 3)
        Standard deviation of each observation's (uL, uR, v) [px].
    usable : (n,)
        Which observations may be fused.
    blas_threads : int
    """

    name: str
    section: Mapping[str, Any]
    problem: Problem
    sequence: Sequence
    sigma: Array
    usable: BoolArray
    blas_threads: int

    def run(self, on_frame: Callable[[int], None] = lambda k: None) -> Run:
        """Build the estimator and run it.

        Raises
        ------
        RunInterrupted
            On an Interrupted, of this process or from ``on_frame``, with the run so far.
        """
        solver = member(self.name, self.section).build(self.problem)
        if isinstance(solver, Unbuilt):
            return loop.not_run(self.name, self.sequence, solver.failure)
        return loop.run(
            solver,
            self.sequence,
            self.sigma,
            name=self.name,
            usable=self.usable,
            on_frame=on_frame,
            blas_threads=self.blas_threads,
        )
