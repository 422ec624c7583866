"""The order in which the estimators of a comparison run, what each of them may fuse, and what is kept."""

import hashlib
from collections.abc import Callable, Mapping
from collections.abc import Sequence as Several
from dataclasses import dataclass, replace
from itertools import takewhile

import numpy as np

from vislam.base.errors import ConfigError, DivergedError, Interrupted
from vislam.base.progress import Progress
from vislam.base.types import Array, BoolArray
from vislam.comparison.job import Job
from vislam.comparison.keeping import Keeper
from vislam.comparison.members import Unbuilt
from vislam.comparison.side_by_side import SideBySide
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
        job: Callable[[str, BoolArray], Job],
        at_a_time: int = 1,
    ) -> tuple[dict[str, Run], bool]:
        """Run the estimators, and whether it was interrupted.

        With a common observation set, only what is on it is usable for all that it binds. Without one, what
        ``gates_from`` gates is not usable for all that follow, which wait for it.

        Each run is kept as soon as it has ended, whatever becomes of those after it. One that was interrupted
        keeps the frames that it had done; those that were not reached have none.

        Parameters
        ----------
        estimators : mapping of str to Estimator or Unbuilt
            By the name of their run, in order.
        common_set : CommonSet or None
        gates_from : str or None
        job : callable
            What a process of its own needs for the run of a name that is given some observations ``(n,)``.
        at_a_time : int
            Runs at the same time, each in a process of its own; 1: one after the other, in this process.
        """
        runs: dict[str, Run] = {}
        kept: set[str] = set()
        names, interrupted = tuple(estimators), False

        def keep(run: Run) -> None:
            runs[run.name] = run
            self.keeper.keep(run)
            kept.add(run.name)

        try:
            for group in _groups(names, None if common_set is not None else gates_from):
                given = {
                    name: self.given(name, runs, names=names, common_set=common_set, gates_from=gates_from)
                    for name in group
                }
                away = self._away(given, estimators) if at_a_time > 1 else []
                if away:
                    with SideBySide(
                        [job(name, given[name]) for name in away], at_a_time, self.progress
                    ) as some:
                        self._follow(some, given, keep=keep, unfinished=runs)
                for name in group:
                    if name not in away:
                        keep(self._found(estimators[name], name, given[name]))
        except loop.RunInterrupted as stop:
            runs[stop.run.name], interrupted = stop.run, True
        except Interrupted:
            interrupted = True
        for name in runs.keys() - kept:
            self.keeper.keep(runs[name])
        reason = Interrupted()
        return {
            name: runs[name] if name in runs else loop.not_run(name, self.sequence, reason) for name in names
        }, interrupted

    def given(
        self,
        name: str,
        runs: Mapping[str, Run],
        *,
        names: Several[str],
        common_set: CommonSet | None,
        gates_from: str | None,
    ) -> BoolArray:
        """Which observations ``(n,)`` a run is given, where ``names`` is the order of all runs."""
        if common_set is not None and name not in common_set.exempt:
            return common_set.kept
        before = takewhile(lambda other: other != name, names)
        if common_set is None and gates_from is not None and gates_from in before:
            return ~runs[gates_from].gated
        return np.ones(self.sequence.observations, bool)

    def _away(
        self, given: Mapping[str, BoolArray], estimators: Mapping[str, Estimator | Unbuilt]
    ) -> list[str]:
        """Runs to be done in processes of their own; a single one has the machine for itself in this one."""
        away = [
            name
            for name, usable in given.items()
            if not isinstance(estimators[name], Unbuilt)
            and not self.keeper.has(name, identity=self._identity(name, usable))
        ]
        return away if len(away) > 1 else []

    def _follow(
        self,
        several: SideBySide,
        given: Mapping[str, BoolArray],
        *,
        keep: Callable[[Run], None],
        unfinished: dict[str, Run],
    ) -> None:
        """Keep runs as they end; of those that ran when it was interrupted, what they had done."""
        try:
            for run in several.finished():
                keep(replace(run, identity=self._identity(run.name, given[run.name])))
        except Interrupted:
            for run in several.stopped():
                unfinished.setdefault(run.name, run)
            raise

    def _found(
        self, solver: Estimator | Unbuilt, name: str, usable: BoolArray, *, preparatory: bool = False
    ) -> Run:
        """Run of an earlier start, or of this one."""
        identity = self._identity(name, usable)
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

    def _identity(self, name: str, usable: BoolArray) -> str:
        text = f"{self.identity}|{name}|".encode() + np.packbits(usable).tobytes()
        return hashlib.sha256(text).hexdigest()[:_IDENTITY_DIGITS]


def _groups(names: Several[str], first: str | None) -> list[Several[str]]:
    """Runs that do not wait for each other: all, or those up to the one that decides for the rest."""
    if first is None:
        return [names]
    cut = names.index(first) + 1
    return [names[:cut], names[cut:]]
