"""What the figures and the scene are drawn from."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vislam.data import Sequence
from vislam.data.reference import Reference
from vislam.evaluation import Evaluation
from vislam.evaluation.trajectory import match
from vislam.run import Run
from vislam.types import Array, IntArray

# Okabe and Ito's colours, which the colour-blind can tell apart; for more runs than six, some of Tol's.
COLOURS = (
    *("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00"),
    *("#332288", "#999933", "#882255"),
)


@dataclass(frozen=True)
class Shown:
    """Results of a comparison, ready to be drawn.

    Attributes
    ----------
    runs : mapping of name to Run
        Levelled, and with at least three frames each.
    reference : Reference or None
    evaluation : Evaluation
    sequence : Sequence
        The repaired recording.
    """

    runs: Mapping[str, Run]
    reference: Reference | None
    evaluation: Evaluation
    sequence: Sequence

    @classmethod
    def of(
        cls,
        runs: Mapping[str, Run],
        reference: Reference | None,
        evaluation: Evaluation,
        sequence: Sequence,
    ) -> "Shown":
        """Take the runs that are long enough, levelled."""
        long_enough = {name: run.levelled() for name, run in runs.items() if len(run.stamp) > 2}
        return cls(long_enough, reference, evaluation, sequence)

    def colour(self, name: str) -> str:
        """Colour of a run, the same in every figure."""
        return COLOURS[list(self.runs).index(name) % len(COLOURS)]

    def time(self, run: Run) -> Array:
        """Time since the start of the recording at each frame of a run, ``(T,)`` [s]."""
        return run.stamp - self.sequence.stamp[0]

    def matched(self, run: Run) -> bool:
        """Whether the reference covers enough frames of a run for an alignment."""
        if self.reference is None:
            return False
        return int(np.count_nonzero(self.reference.frame < len(run.stamp))) > 2

    def drawn_T_world(self, run: Run, *, planar: bool) -> Array:
        """Motion ``(4, 4)`` that lays a run on the reference; the identity where that cannot be told.

        Parameters
        ----------
        run : Run
        planar : bool
            Turn about the vertical and move in the plane only.
        """
        pose = np.eye(4)
        if self.reference is not None and self.matched(run):
            aligned = match(run.world_T_imu, self.reference, planar=planar)
            size = len(aligned.translation)
            pose[:size, :size], pose[:size, 3] = aligned.rotation, aligned.translation
        return pose

    def positions(self, world_T_imu: Array) -> Array:
        """Positions ``(T, 3)`` [m] of the point that the reference is about."""
        point = np.eye(4) if self.reference is None else self.reference.imu_T_point
        return (world_T_imu @ point)[:, :3, 3]

    def first_seen(self, run: Run) -> IntArray:
        """Frame in which each landmark of a run was seen first, ``(m,)``."""
        track, row = np.unique(self.sequence.track, return_index=True)
        return np.asarray(self.sequence.frame_of[row][np.searchsorted(track, run.track)])
