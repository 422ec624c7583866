"""Backward pass: smoothed estimates of the marginalised landmarks and of the poses.

The filter's steps are recorded as far as memory allows. Older stretches are dropped and only the state at
their start is kept, from which they are computed once more when the backward pass comes to them; where even
these states become too many, every other one goes.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.frame import Frame
from vislam.core.step import Step as Answer
from vislam.estimators.ekf.linear import Adjoint, Step
from vislam.estimators.ekf.parametrisation import Parametrisation
from vislam.estimators.ekf.state import JointState, Marginalised, PoseRows
from vislam.geometry import se3
from vislam.models.odometry import POSE

_STRETCH = 16
"""Frames between two states that are kept, at most."""
_STRETCH_SHARE = 0.25
"""Share of the memory that the steps of a stretch may take before the next one begins."""
_STATES_SHARE = 0.25
"""Share of the memory that the kept states may take."""

Advance = Callable[[JointState, Frame], Answer]


@dataclass(frozen=True)
class Landmarks:
    """Landmarks in the world.

    Attributes
    ----------
    track : (m,)
    points_world : (m, 3)
        [m].
    points_cov : (m, 3, 3)
        Marginal covariances [m^2].
    points_pose_cov : (m, 3, 6)
        Cross-covariances with the last pose, whose error is on its right.
    """

    track: IntArray
    points_world: Array
    points_cov: Array
    points_pose_cov: Array

    @classmethod
    def join(cls, parts: Sequence["Landmarks"]) -> "Landmarks":
        """All landmarks, their ids ascending; of a re-initialised one, the first."""
        _, order = np.unique(np.concatenate([part.track for part in parts]), return_index=True)
        names = (item.name for item in fields(cls))
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts])[order] for name in names})


@dataclass(frozen=True)
class Smoothed:
    """Smoothed estimates, from all data.

    Attributes
    ----------
    world_T_imu : (T, 4, 4)
        Poses; empty if they were not asked for.
    pose_cov : (T, 6, 6)
        Their covariances, on the right.
    landmarks : Landmarks
    """

    world_T_imu: Array
    pose_cov: Array
    landmarks: Landmarks


@dataclass
class _Stretch:
    """Some frames on end: the state before them, what came in, and the steps taken, unless dropped."""

    before: JointState
    inputs: list[Frame] = field(default_factory=list)
    steps: list[Step] | None = field(default_factory=list)
    nbytes: int = 0

    def full(self, memory: int) -> bool:
        """Whether the next one is to begin, so that dropping one leaves others in ``memory`` [bytes]."""
        return len(self.inputs) >= _STRETCH or self.nbytes > _STRETCH_SHARE * memory


class Recorder:
    """Steps of a filter in the order they were taken, within bounded memory.

    Attributes
    ----------
    again : int
        Frames that had to be computed once more.
    peak : int
        Most memory that was held [bytes].
    latest : list of Step
        The steps of the last frame.
    """

    def __init__(self, advance: Advance, *, memory: int) -> None:
        self._advance = advance
        self._memory = memory
        self._stretches: list[_Stretch] = []
        self._dropped = 0
        self._held = 0
        self._states = 0
        self.again = 0
        self.peak = 0
        self.latest: list[Step] = []

    def take(self, state: JointState, frame: Frame) -> Answer:
        """Advance the state by a frame, and record its steps."""
        if not self._stretches or self._stretches[-1].full(self._memory):
            self._stretches.append(_Stretch(state.copy()))
            self._held += state.nbytes
            self._states += state.nbytes
        current = self._stretches[-1]
        assert current.steps is not None
        state.steps = current.steps
        before = len(current.steps)
        record = self._advance(state, frame)
        current.inputs.append(frame)
        self.latest = current.steps[before:]
        added = sum(step.nbytes for step in self.latest)
        current.nbytes += added
        self._held += added
        self.peak = max(self.peak, self._held)
        self._make_room()
        return record

    def backwards(self) -> Iterator[Step]:
        """All steps, the last first; those that were returned are discarded."""
        while self._stretches:
            stretch = self._stretches.pop()
            if stretch.steps is None:
                again = Recorder(self._advance, memory=self._memory)
                for frame in stretch.inputs:
                    again.take(stretch.before, frame)
                yield from again.backwards()
                self.again += len(stretch.inputs) + again.again
            else:
                while stretch.steps:
                    yield stretch.steps.pop()
        self._dropped = self._held = self._states = 0

    def _make_room(self) -> None:
        while self._held > self._memory and self._dropped < len(self._stretches) - 1:
            stretch = self._stretches[self._dropped]
            stretch.steps = None
            self._held -= stretch.nbytes
            self._dropped += 1
            if self._states > _STATES_SHARE * self._memory:
                self._thin_out()

    def _thin_out(self) -> None:
        """Join the dropped stretches two by two."""
        dropped, kept = self._stretches[: self._dropped], self._stretches[self._dropped :]
        for first, second in zip(dropped[::2], dropped[1::2], strict=False):
            first.inputs += second.inputs
            self._held -= second.before.nbytes
            self._states -= second.before.nbytes
        self._stretches = dropped[::2] + kept
        self._dropped = len(dropped[::2])


def smooth(state: JointState, recorder: Recorder) -> Smoothed:
    """Smooth over the recorded steps, backwards from ``state``."""
    adjoint = Adjoint.of_the_last(len(state.cov))
    landmarks = [filtered_landmarks(state, np.arange(len(state.track)))]
    poses: list[Array] = []
    covs: list[Array] = []
    for step in recorder.backwards():
        if isinstance(step, Marginalised):
            landmarks.append(_told(step, adjoint, state.parametrisation))
        elif isinstance(step, PoseRows):
            error, loss, _ = adjoint.expected(step.rows)
            poses.append(se3.retract(step.world_T_imu, error))
            covs.append(_without(step.rows[:, POSE], loss))
        else:
            adjoint = step.back(adjoint)
    return Smoothed(
        world_T_imu=np.array(poses[::-1]).reshape(-1, 4, 4),
        pose_cov=np.array(covs[::-1]).reshape(-1, 6, 6),
        landmarks=Landmarks.join(landmarks),
    )


def filtered_landmarks(state: JointState, slots: IntArray) -> Landmarks:
    """Filtered estimates of landmarks."""
    left = state.marginalised(slots)
    return _landmarks(left, left.q, left.cov, left.rows[:, :, POSE], state.parametrisation)


def _told(left: Marginalised, adjoint: Adjoint, parametrisation: Parametrisation) -> Landmarks:
    """Smoothed estimates of marginalised landmarks."""
    error, loss, cross = adjoint.expected(left.rows)
    return _landmarks(left, left.q + error, _without(left.cov, loss), cross, parametrisation)


def _without(cov: Array, loss: Array) -> Array:
    """Covariances ``(..., k, k)`` less a loss: a small difference of numbers that may be large.

    They are symmetric to rounding only.
    """
    left = cov - loss
    return np.asarray(0.5 * (left + np.swapaxes(left, -1, -2)))


def _landmarks(
    left: Marginalised, q: Array, cov: Array, cross: Array, parametrisation: Parametrisation
) -> Landmarks:
    """Points of coordinates ``q (n, 3)`` with their covariances, and those with the last pose."""
    points, jacobian = parametrisation.points(q)
    turned = left.anchors[:, :3, :3] @ jacobian
    return Landmarks(
        track=left.track,
        points_world=(left.anchors[:, :3, :3] @ points[:, :, None])[:, :, 0] + left.anchors[:, :3, 3],
        points_cov=turned @ cov @ turned.transpose(0, 2, 1),
        points_pose_cov=turned @ cross,
    )
