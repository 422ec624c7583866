"""What the figures and the scene are drawn from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.record import Record
from vislam.core.reference import Reference
from vislam.core.run import ESTIMATES, Estimate, Run
from vislam.evaluation import Evaluation
from vislam.evaluation.agreement import Agreement
from vislam.evaluation.attribution import AblationStep
from vislam.evaluation.scores import EstimateScores
from vislam.evaluation.trajectory import distance_driven
from vislam.evaluation.trajectory_scores import TrajectoryScores
from vislam.geometry import se3
from vislam.report.colours import colours


@dataclass(frozen=True)
class Shown:
    """Results of a comparison, ready to be drawn.

    Attributes
    ----------
    runs : mapping of name to Run
        Levelled, and with at least three frames each.
    record : Record
        Of the sequence.
    evaluation : Evaluation
    steps : sequence of AblationStep
    estimate : "filtered", "smoothed" or None
        The one that is shown, which is then the final one of the runs; None: whatever is theirs.
    """

    runs: Mapping[str, Run]
    record: Record
    evaluation: Evaluation
    steps: Sequence[AblationStep]
    estimate: Estimate | None = None

    @classmethod
    def of(
        cls, runs: Mapping[str, Run], record: Record, evaluation: Evaluation, steps: Sequence[AblationStep]
    ) -> "Shown":
        """Take the runs that are long enough, levelled as they were scored."""
        long_enough = {name: evaluation.scores[name].run for name, run in runs.items() if len(run.stamp) > 2}
        return cls(long_enough, record, evaluation, steps)

    @property
    def reference(self) -> Reference | None:
        """What the runs are scored against."""
        return self.record.reference

    def blocks(self) -> "list[Shown]":
        """One for each estimate that some run has, with the runs that have it and what they have of it."""
        found = []
        for estimate in ESTIMATES:
            own = {name: run for name, run in self.runs.items() if estimate in run.estimates}
            if estimate == "filtered":
                own = {name: replace(run, smoothed=None) for name, run in own.items()}
            if own:
                found.append(replace(self, runs=own, estimate=estimate))
        return found

    @property
    def scores(self) -> dict[str, EstimateScores]:
        """Scores of what is shown of the runs."""
        every = {name: self.evaluation.scores[name] for name in self.runs}
        return {
            name: one.final if self.estimate is None else one.estimates[self.estimate]
            for name, one in every.items()
        }

    def label(self, name: str) -> str:
        """Name of a run, with the estimate that is shown where those of the runs differ."""
        ends = {run.estimates[-1] for run in self.runs.values()}
        return name if len(ends) == 1 else f"{name}, {self.runs[name].estimates[-1]}"

    def seeing(self) -> list[str]:
        """Runs that have seen the camera, or all, if none has: the others would flatten them in a figure."""
        return [name for name, run in self.runs.items() if len(run.landmarks)] or list(self.runs)

    def agreements(self) -> dict[tuple[str, str], Agreement]:
        """Agreement of each two of these runs that both have covariances, in one estimate."""
        seeing, found = set(self.seeing()), {}
        for pair, scores in self.evaluation.pairs.items():
            one = scores.estimates.get(self.estimate) if self.estimate is not None else None
            if one is not None and one.agreement is not None and seeing >= set(pair):
                found[pair] = one.agreement
        return found

    def colour(self, name: str) -> str:
        """Colour of a run, the same in every figure."""
        return colours(key for key, one in self.evaluation.scores.items() if len(one.run.stamp) > 2)[name]

    def time(self, run: Run) -> Array:
        """Time since the start of the recording at each frame of a run, ``(T,)`` [s]."""
        return run.stamp - self.record.stamp[0]

    def matched_time(self, found: TrajectoryScores) -> Array:
        """Time since the start of the recording of each error of a trajectory, ``(m,)`` [s]."""
        return found.matched.stamp - self.record.stamp[0]

    def time_at(self, frame: IntArray) -> Array:
        """Time since the start of the recording at frames, of the same shape [s]."""
        return self.record.stamp[frame] - self.record.stamp[0]

    def leaving(self) -> list[str]:
        """Runs that do not set the scale of a figure: those that have not seen the camera, beside others."""
        seeing = self.seeing()
        return [name for name in self.runs if name not in seeing]

    def travelled(self) -> tuple[Array, Array]:
        """Time [s] and distance travelled [m] of a page's abscissa, both ``(T,)``.

        The distance is that along the smoothed path, or else the filtered one, of the first complete run that
        has seen the camera: the same for all figures. Without any run both are empty.
        """
        ranked = sorted(
            self.seeing(), key=lambda name: (not self.runs[name].complete, list(self.runs).index(name))
        )
        if not ranked:
            return np.empty(0), np.empty(0)
        run = self.runs[ranked[0]]
        return self.time(run), distance_driven(run.final.world_T_imu)

    def drawn_T_world(self, name: str, *, planar: bool) -> Array:
        """Transform ``(4, 4)`` that aligns a run to the reference; the identity where there is none."""
        found = self.scores[name].trajectory
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
