"""What inertia and tracks say of the steps between the first frames of a sequence."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.imu import ImuStep
from vislam.core.rigid_fit import (
    FEWEST,
    RigidFit,
    continuations,
    fit_rigid,
    predicted_steps,
    rigid_fits,
    step_spread,
)
from vislam.core.sequence import Sequence
from vislam.geometry import se3
from vislam.models.imu import ImuNoise
from vislam.models.preintegration import Preintegrated

_SAME = 1e-6
"""Times nearer than this are the same [s]."""


@dataclass(frozen=True)
class Window:
    """Steps from the first frame on, each over one or more frames.

    Attributes
    ----------
    frame : (K + 1,)
        Frames of the sequence between which they are.
    stamp : (K + 1,)
        [s].
    inertia : tuple of ImuStep
        K of them.
    motion : (K, 4, 4)
        ``prev_T_next`` of the body by the tracks; the identity where these do not tell it.
    cov : (K, 6, 6)
        Of its error on the right.
    told : (K,)
        Which of them the tracks tell.
    """

    frame: IntArray
    stamp: Array
    inertia: tuple[ImuStep, ...]
    motion: Array
    cov: Array
    told: BoolArray

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.inertia)

    @property
    def length(self) -> float:
        """From the first frame to the last [s]."""
        return float(self.stamp[-1] - self.stamp[0])

    @property
    def covered(self) -> float:
        """Share of its length with inertial samples."""
        return 1.0 - sum(step.missing for step in self.inertia) / self.length

    def first(self, steps: int) -> "Window":
        """Return the first steps only."""
        return Window(
            self.frame[: steps + 1],
            self.stamp[: steps + 1],
            self.inertia[:steps],
            self.motion[:steps],
            self.cov[:steps],
            self.told[:steps],
        )

    def preintegrated(self, noise: ImuNoise, gyro_bias: Array, accel_bias: Array) -> list[Preintegrated]:
        """Inertial motion of each step."""
        return [step.preintegrated(noise, gyro_bias, accel_bias) for step in self.inertia]

    def poses(self) -> Array:
        """Poses ``first_T_k (K + 1, 4, 4)`` of the body by the tracks."""
        out = np.empty((len(self) + 1, 4, 4))
        out[0] = np.eye(4)
        for k, step in enumerate(self.motion):
            out[k + 1] = out[k] @ step
        return out


def window_of(sequence: Sequence, *, seconds: float, most: int, step: float) -> Window:
    """Steps over the first ``seconds`` [s], of the first ``most`` frames at most; two frames at least.

    A step spans as many frames as ``step`` [s] has: the errors of two steps of the tracks have the frame
    between them in common, and cancel, so that long steps tell more than many short ones that are taken for
    independent.
    """
    assert sequence.imu is not None
    inside = int(np.searchsorted(sequence.stamp, sequence.stamp[0] + seconds + _SAME, side="right"))
    part = sequence.first(min(max(inside, 2), most))
    part = part.select(part.disparity > 0.0)
    stride = max(int(step / float(np.median(np.diff(part.stamp))) + _SAME), 1)
    frames = np.arange(0, len(part), min(stride, len(part) - 1))
    fits = _fits(part, frames)
    imu_T_cam = part.rig.imu_T_cam
    adjoint = se3.adjoint(imu_T_cam)
    motion, cov = (np.tile(np.eye(size), (len(fits), 1, 1)) for size in (4, 6))
    told = np.zeros(len(fits), bool)
    for k, fit in enumerate(fits):
        if fit is not None and np.isfinite(fit.cov).all() and np.isfinite(fit.next_T_prev).all():
            motion[k] = imu_T_cam @ se3.inverse(fit.next_T_prev) @ se3.inverse(imu_T_cam)
            cov[k] = adjoint @ fit.cov @ adjoint.T
            told[k] = True
    stamp = part.stamp[frames]
    inertia = tuple(sequence.imu.steps(stamp, clock_offset=part.clock_offset))[1:]
    return Window(frames, stamp, inertia, motion, cov, told)


def _fits(sequence: Sequence, frames: IntArray) -> list[RigidFit | None]:
    """Fits from each of the frames to the next of them, begun at the steps between."""
    steps = predicted_steps(sequence)
    for k, fit in rigid_fits(sequence, continuations(sequence)).items():
        steps[k] = fit.next_T_prev
    points, spread = sequence.rig.back_project(sequence.z), step_spread(sequence.disparity)
    out: list[RigidFit | None] = []
    for one, two in pairwise(frames):
        old, new = (slice(sequence.offset[k], sequence.offset[k + 1]) for k in (one, two))
        _, before, after = np.intersect1d(sequence.track[old], sequence.track[new], return_indices=True)
        guess = np.eye(4)
        for k in range(one + 1, two + 1):
            guess = steps[k] @ guess
        enough = len(before) >= FEWEST
        out.append(
            fit_rigid(
                sequence.rig,
                points[old][before],
                sequence.z[new][after],
                spread=spread[old][before],
                guess=guess,
            )
            if enough
            else None
        )
    return out
