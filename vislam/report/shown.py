"""What the figures and the scene are drawn from."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.record import Record
from vislam.core.reference import Reference
from vislam.core.run import Run
from vislam.evaluation import Evaluation
from vislam.evaluation.agreement import Agreement
from vislam.evaluation.attribution import Rung
from vislam.evaluation.scores import RunScores
from vislam.geometry import se3

# Okabe and Ito's colours, which the colour-blind can tell apart; for more runs than six, some of Tol's.
COLOURS = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"),
    *("#332288", "#999933", "#882255"),
)


def colours(names: Iterable[str]) -> dict[str, str]:
    """One colour for each run, the same wherever it is drawn."""
    return {name: COLOURS[index % len(COLOURS)] for index, name in enumerate(names)}


@dataclass(frozen=True)
class Shown:
    """Results of a comparison, ready to be drawn.

    Attributes
    ----------
    runs : mapping of name to Run
        Levelled, and with at least three frames each.
    record : Record
        Of the drive.
    evaluation : Evaluation
    rungs : sequence of Rung
    """

    runs: Mapping[str, Run]
    record: Record
    evaluation: Evaluation
    rungs: Sequence[Rung]

    @classmethod
    def of(
        cls, runs: Mapping[str, Run], record: Record, evaluation: Evaluation, rungs: Sequence[Rung]
    ) -> "Shown":
        """Take the runs that are long enough, levelled as they were scored."""
        long_enough = {name: evaluation.scores[name].run for name, run in runs.items() if len(run.stamp) > 2}
        return cls(long_enough, record, evaluation, rungs)

    @property
    def reference(self) -> Reference | None:
        """What the runs are scored against."""
        return self.record.reference

    @property
    def scores(self) -> dict[str, RunScores]:
        """Scores of the runs that are shown."""
        return {name: self.evaluation.scores[name] for name in self.runs}

    def seeing(self) -> list[str]:
        """Runs that have seen the camera, or all, if none has: the others would flatten them in a figure."""
        return [name for name, run in self.runs.items() if len(run.landmarks)] or list(self.runs)

    def agreements(self) -> dict[tuple[str, str], Agreement]:
        """Agreement of each two of these runs, of which both claim something."""
        seeing = set(self.seeing())
        return {
            pair: scores.agreement
            for pair, scores in self.evaluation.pairs.items()
            if scores.agreement is not None and seeing >= set(pair)
        }

    def colour(self, name: str) -> str:
        """Colour of a run, the same in every figure."""
        return colours(self.runs)[name]

    def time(self, run: Run) -> Array:
        """Time since the start of the recording at each frame of a run, ``(T,)`` [s]."""
        return run.stamp - self.record.stamp[0]

    def drawn_T_world(self, name: str, *, planar: bool) -> Array:
        """Motion ``(4, 4)`` that lays a run on the reference; the identity where that cannot be told."""
        found = self.evaluation.scores[name].final
        if found is None:
            return np.eye(4)
        laid = found.alignments["planar" if planar else "se3"]
        return se3.from_rotation_translation(laid.rotation, laid.translation)

    def positions(self, world_T_imu: Array) -> Array:
        """Positions ``(T, 3)`` [m] of the point that the reference is about."""
        point = np.eye(4) if self.reference is None else self.reference.imu_T_point
        return (world_T_imu @ point)[:, :3, 3]

    def first_seen(self, run: Run) -> IntArray:
        """Frame in which each landmark of a run was seen first, ``(m,)``."""
        given = self.record.given
        track, row = np.unique(given.track, return_index=True)
        return np.asarray(given.frame[row][np.searchsorted(track, run.landmarks.track)])
