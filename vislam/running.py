"""The order in which the estimators of a comparison run, and what each of them is refused."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vislam import estimator
from vislam.data.sequence import Sequence
from vislam.errors import ConfigError, DivergedError
from vislam.estimator import Estimator, Problem
from vislam.frozen import FrozenList
from vislam.members import Member
from vislam.run import Run
from vislam.terminal import Terminal
from vislam.types import Array, BoolArray


@dataclass(frozen=True)
class Runner:
    """What all runs of a comparison share.

    Attributes
    ----------
    sequence : Sequence
    sigma : (n, 3)
        Standard deviation of each observation's (uL, uR, v) [px].
    blas_threads : int
    terminal : Terminal
        Shows how far they are.
    """

    sequence: Sequence
    sigma: Array
    blas_threads: int
    terminal: Terminal

    def freeze(self, members: Mapping[str, Member], problem: Problem, *, by: tuple[str, ...]) -> FrozenList:
        """Run the members named in ``by``, each without what those before it left out; keep what all fused.

        Raises
        ------
        DivergedError
            If one of them is incomplete.
        ConfigError
            If nothing is left.
        """
        kept = np.ones(self.sequence.observations, bool)
        for name in by:
            found = self._run(members[name].build(problem), name, ~kept, title=f"{name}, for the list")
            if not found.complete:
                raise DivergedError(f"frozen_by: {name} is incomplete, so there is no list: {found.error}")
            kept &= found.used
            if not kept.any():
                raise ConfigError(f"frozen_by: {name} has fused no observation that those before it fused")
        exempt = tuple(name for name, member in members.items() if member.takes_all)
        return FrozenList.of(self.sequence, kept, by=by, exempt=exempt)

    def run_all(
        self, estimators: Mapping[str, Estimator], *, frozen: FrozenList | None, gates_from: str | None
    ) -> dict[str, Run]:
        """Run the estimators one after the other.

        With a frozen list, what is not on it is refused to all that it binds. Without one, what
        ``gates_from`` gates is refused to all that follow.
        """
        nothing = np.zeros(self.sequence.observations, bool)
        refused = nothing if frozen is None else ~frozen.kept
        runs = {}
        for name, solver in estimators.items():
            exempt = frozen is not None and name in frozen.exempt
            runs[name] = self._run(solver, name, nothing if exempt else refused, title=name)
            if frozen is None and name == gates_from:
                refused = runs[name].gated
        return runs

    def _run(self, solver: Estimator, name: str, refused: BoolArray, *, title: str) -> Run:
        with self.terminal.progress(title, len(self.sequence)) as bar:
            return estimator.run(
                solver,
                self.sequence,
                self.sigma,
                name=name,
                refused=refused,
                on_frame=lambda k: bar.update(0, completed=k + 1),  # type: ignore[arg-type]
                blas_threads=self.blas_threads,
            )
