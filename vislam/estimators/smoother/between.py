"""Frames between keyframes: predicted as they come, and filled in between neighbours in the end.

The graph has variables and one inertial factor a keyframe. Its frames are numbered without those between, and
an inertial step is that since the keyframe before. A frame between has the pose that the newest keyframe
predicts. In the end, with all keyframes estimated, it has the mean of what both neighbours say
(:mod:`vislam.models.inertial_gap`): the same as with variables of its own, as it has no observations.
"""

from collections.abc import Sequence
from dataclasses import replace

import gtsam
import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.estimator import Inertia, Problem
from vislam.core.frame import Frame
from vislam.core.imu import ImuStep
from vislam.core.step import State, Step
from vislam.estimators.smoother.batch import Drive
from vislam.estimators.smoother.engine import Engine
from vislam.estimators.smoother.keys import B, V, X
from vislam.estimators.smoother.tracks import Track
from vislam.models.imu import ACCEL_BIAS, GYRO_BIAS, VELOCITY
from vislam.models.inertial_gap import InertialState, fill_gap
from vislam.models.preintegration import Preintegrated

_ORDER = np.r_[0:9, 12:15, 9:12]
"""GTSAM has the accelerometer's bias first."""


class Between:
    """The frames of a sequence, those between keyframes among them.

    Attributes
    ----------
    frames : list of Frame
        All, as they came; none without raw inertia, by which alone there are frames between keyframes.
    """

    def __init__(self, problem: Problem) -> None:
        self._inertia: Inertia | None = problem.imu
        self.frames: list[Frame] = []
        # Place of each keyframe among all frames.
        self._place: list[int] = []
        self._state: InertialState | None = None
        self._cov: Array | None = None

    @property
    def any(self) -> bool:
        """Whether there is a frame between keyframes."""
        return len(self._place) < len(self.frames)

    def keyframe(self, frame: Frame) -> Frame:
        """The frame as the graph has it: by its number among keyframes, with the step since the last one."""
        if self._inertia is None:
            # All frames are keyframes, and a lag need not hold them.
            return frame
        self.frames.append(frame)
        since = self._place[-1] + 1 if self._place else 0
        self._place.append(len(self.frames) - 1)
        self._state = self._cov = None
        if len(self._place) == len(self.frames):
            return frame
        steps = self.frames[since:]
        samples = [step.imu for step in steps if step.imu is not None]
        return replace(
            frame,
            k=len(self._place) - 1,
            dt=sum(step.dt for step in steps),
            imu=ImuStep.joined(samples),
        )

    def predict(self, frame: Frame, engine: Engine, *, with_cov: bool) -> Step:
        """Pose, velocity and biases at a frame between, from those of the newest keyframe.

        Parameters
        ----------
        frame : Frame
        engine : Engine
            As it was updated with that keyframe.
        with_cov : bool
            Whether the covariance is asked for.
        """
        assert self._inertia is not None
        self.frames.append(frame)
        if self._state is None:
            newest = len(self._place) - 1
            self._state = self.state(engine, newest)
            if with_cov:
                joint = engine.joint_covariance([X(newest), V(newest), B(newest)])
                self._cov = joint[np.ix_(_ORDER, _ORDER)]
        step = self._preintegrated(frame, self._state)
        if self._cov is not None:
            transition, noise = step.linear(self._state.pose[:3, :3])
            self._cov = transition @ self._cov @ transition.T + noise
        self._state = self._state.predicted(step, self._inertia.noise.gravity_world)
        return _answer(self._state, self._cov)

    @staticmethod
    def state(engine: Engine, k: int) -> InertialState:
        """State at a frame of the graph, as an engine has it."""
        return _state(engine.pose(X(k)), engine.vector(V(k)), engine.imu_bias(B(k)))

    def filled(self, states: Sequence[InertialState]) -> list[InertialState]:
        """States at all frames from those at the keyframes."""
        assert self._inertia is not None
        gravity, found = self._inertia.noise.gravity_world, []
        ends = [*self._place[1:], len(self.frames) - 1]
        for number, (begin, end) in enumerate(zip(self._place, ends, strict=True)):
            before = states[number]
            after = states[number + 1] if number + 1 < len(states) else None
            steps = [self._preintegrated(frame, before) for frame in self.frames[begin + 1 : end + 1]]
            found += [before, *(fill_gap(before, after, steps, gravity) if steps else [])]
        return found

    def whole(self, drive: Drive, values: gtsam.Values) -> tuple[Drive, gtsam.Values]:
        """The problem with variables at all frames, and its estimate from that at the keyframes."""
        states = [
            _state(values.atPose3(X(k)).matrix(), values.atVector(V(k)), values.atConstantBias(B(k)))
            for k in range(len(drive.frames))
        ]
        tracks = self.renumbered(drive.tracks)
        found = gtsam.Values()
        for track in tracks:
            found.insert(track.key, values.atPoint3(track.key))
        for k, state in enumerate(self.filled(states)):
            found.insert(X(k), gtsam.Pose3(state.pose))
            found.insert(V(k), state.velocity)
            found.insert(B(k), gtsam.imuBias.ConstantBias(state.accel_bias, state.gyro_bias))
        return Drive(drive.rig, drive.motion, drive.stereo, self.frames, tracks), found

    def places(self, frames: IntArray) -> IntArray:
        """Numbers among all frames of frames of the graph."""
        return np.array(self._place, dtype=np.int64)[frames] if self.any else frames

    def renumbered(self, tracks: Sequence[Track]) -> list[Track]:
        """Tracks whose observations have the numbers of their frames among all."""
        if not self.any:
            return list(tracks)
        return [
            replace(track, views=[replace(view, k=self._place[view.k]) for view in track.views])
            for track in tracks
        ]

    def _preintegrated(self, frame: Frame, state: InertialState) -> Preintegrated:
        assert self._inertia is not None
        assert frame.imu is not None
        return frame.imu.preintegrated(self._inertia.noise, state.gyro_bias, state.accel_bias)


def _state(pose: Array, velocity: Array, bias: gtsam.imuBias.ConstantBias) -> InertialState:
    return InertialState(pose, velocity, bias.gyroscope(), bias.accelerometer())


def _answer(state: InertialState, cov: Array | None) -> Step:
    value = {VELOCITY: state.velocity, GYRO_BIAS: state.gyro_bias, ACCEL_BIAS: state.accel_bias}
    if cov is None:
        return Step(state.pose, states={name: State(one) for name, one in value.items()})
    sigma = np.split(np.sqrt(np.diagonal(cov)[6:]), 3)
    states = {name: State(one, known) for (name, one), known in zip(value.items(), sigma, strict=True)}
    return Step(state.pose, cov[:6, :6].copy(), states=states)
