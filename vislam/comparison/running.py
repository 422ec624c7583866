"""The order in which the estimators of a comparison run, what each of them may fuse, and what is kept."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from vislam.base.errors import ConfigError, DivergedError, Interrupted
from vislam.base.progress import Progress
from vislam.base.types import Array, BoolArray
from vislam.comparison.keeping import Keeper
from vislam.comparison.members import Unbuilt
from vislam.core.estimator import Estimator
from vislam.core.observation_set import CommonSet
from vislam.core.run import Run
from vislam.core.sequence import Sequence
from vislam.estimators import loop

_IDENTITY_DIGITS = 16


@dataclass(frozen=True)
class Runner:
    """What all runs of a comparison share.

    Attributes
    ----------
    sequence : Sequence
    sigma : (n, 3)
        Standard deviation of each observation's (uL, uR, v) [px].
    blas_threads : int
    progress : Progress
        Shows how far they are.
    keeper : Keeper
        Is given each run as soon as it has ended, and may have it from an earlier start.
    identity : str
        Hash of all that decides the runs but what each may fuse.
    """

    sequence: Sequence
    sigma: Array
    blas_threads: int
    progress: Progress
    keeper: Keeper
    identity: str = ""

    def freeze(
        self,
        estimators: Mapping[str, Estimator | Unbuilt],
        *,
        by: tuple[str, ...],
        exempt: tuple[str, ...] = (),
    ) -> CommonSet:
        """Run those named in ``by``, each without what those before it left out; keep what all fused.

        Of these, what was seen only once goes too: it says nothing of the motion, and not everyone can
        take it.

        Raises
        ------
        DivergedError
            If one of them is incomplete.
        ConfigError
            If nothing is left.
        """
        kept = np.ones(self.sequence.observations, bool)
        for name in by:
            found = self._found(estimators[name], name, kept, preparatory=True)
            self.keeper.keep(found, preparatory=True)
            if not found.complete:
                raise DivergedError(
                    f"common_set_from: {name} is incomplete, so there is no list: {found.log.error}"
                )
            kept &= found.used
            if not kept.any():
                raise ConfigError(
                    f"common_set_from: {name} has fused no observation that those before it fused"
                )
        kept &= self.sequence.seen_again(kept)
        if not kept.any():
            raise ConfigError("common_set_from: no track is left that was seen more than once")
        return CommonSet.of(self.sequence, kept, by=by, exempt=exempt)

    def run_all(
        self,
        estimators: Mapping[str, Estimator | Unbuilt],
        *,
        common_set: CommonSet | None,
        gates_from: str | None,
    ) -> tuple[dict[str, Run], bool]:
        """Run the estimators one after the other, and whether it was interrupted.

        With a common observation set, only what is on it is usable for all that it binds. Without one, what
        ``gates_from`` gates is not usable for all that follow.

        Each run is kept as soon as it has ended, whatever becomes of those after it. One that was interrupted
        keeps the frames that it had done; those that were not reached have none.
        """
        runs: dict[str, Run] = {}
        kept: set[str] = set()
        interrupted = False
        try:
            for name, solver in estimators.items():
                usable = self.given(name, runs, common_set=common_set, gates_from=gates_from)
                runs[name] = self._found(solver, name, usable)
                self.keeper.keep(runs[name])
                kept.add(name)
        except loop.RunInterrupted as stop:
            runs[stop.run.name], interrupted = stop.run, True
        except Interrupted:
            interrupted = True
        for name in runs.keys() - kept:
            self.keeper.keep(runs[name])
        reason = Interrupted()
        return {
            name: runs[name] if name in runs else loop.not_run(name, self.sequence, reason)
            for name in estimators
        }, interrupted

    def given(
        self, name: str, runs: Mapping[str, Run], *, common_set: CommonSet | None, gates_from: str | None
    ) -> BoolArray:
        """Which observations ``(n,)`` a run is given, where ``runs`` has those before it, in their order."""
        if common_set is not None and name not in common_set.exempt:
            return common_set.kept
        before = list(takewhile(lambda other: other != name, runs))
        if common_set is None and gates_from is not None and gates_from in before:
            return ~runs[gates_from].gated
        return np.ones(self.sequence.observations, bool)

    def _found(
        self, solver: Estimator | Unbuilt, name: str, usable: BoolArray, *, preparatory: bool = False
    ) -> Run:
        """Run of an earlier start, or of this one."""
        text = f"{self.identity}|{name}|".encode() + np.packbits(usable).tobytes()
        identity = hashlib.sha256(text).hexdigest()[:_IDENTITY_DIGITS]
        kept = self.keeper.find(name, identity=identity, preparatory=preparatory)
        if kept is not None:
            return kept
        if isinstance(solver, Unbuilt):
            return loop.not_run(name, self.sequence, solver.failure)
        title = f"{name}, for the common set" if preparatory else name
        with self.progress.bar(title, len(self.sequence)) as bar:
            found = loop.run(
                solver,
                self.sequence,
                self.sigma,
                name=name,
                usable=usable,
                on_frame=lambda k: bar.done(k + 1),
                blas_threads=self.blas_threads,
            )
        return replace(found, identity=identity)
