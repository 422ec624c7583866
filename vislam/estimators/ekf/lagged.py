"""Fixed-lag smoothed poses, carried forward with the filter.

The backward pass (:mod:`vislam.estimators.ekf.backward`) to frame k from every frame k + L would take as many
backward passes as frames. The same smoothed poses come about on the way forward, a fixed-point smoother for
each of the last frames: with C the covariance of the pose's error at its own frame with the error of the
joint state now, and M what a step does to the latter,

    C <- C M^T,

and a measurement with innovation y of covariance S corrects the pose by

    x_hat <- x_hat + C H^T S^-1 y,    P <- P - C H^T S^-1 H C^T,    C <- C - C H^T S^-1 H P_joint.

B. D. O. Anderson and J. B. Moore, *Optimal Filtering* (1979), section 7.2. The rows of all last frames are
one matrix, so that L frames cost about as much as the filter does with L poses more in its state, and nothing
that the filter estimates depends on them.
"""

from collections.abc import Iterable

import numpy as np

from vislam.base.types import Array
from vislam.core.lagged import LagReader, Lags
from vislam.core.trajectory import Poses
from vislam.estimators.ekf.linear import Append, Correction, Keep, Move, Reset, Step
from vislam.estimators.ekf.state import JointState
from vislam.geometry import se3
from vislam.models.odometry import POSE

_SIZE = POSE.stop - POSE.start


class LastPoses:
    """Poses of the last frames, smoothed by the data since.

    Parameters
    ----------
    lags : Lags
        At which they are read; who is older than the largest is forgotten.
    """

    def __init__(self, lags: Lags) -> None:
        self._most = max(lags.frames)
        self._reader = LagReader(lags)
        self._newest = -1
        # Oldest first: poses as filtered, their errors and covariances given all data so far, and C.
        self._pose = np.empty((0, 4, 4))
        self._error = np.empty(0)
        self._cov = np.empty((0, _SIZE, _SIZE))
        self._rows = np.empty((0, 0))

    def follow(self, steps: Iterable[Step], state: JointState) -> None:
        """Take the steps of a frame, which have led to ``state``, and its pose."""
        kept = slice(_SIZE if len(self._pose) > self._most else 0, None)
        self._error, self._rows = self._error[kept], self._rows[kept]
        kept = slice(kept.start // _SIZE, None)
        self._pose, self._cov = self._pose[kept], self._cov[kept]
        for step in steps:
            self._take(step)
        own = state.cov[POSE]
        self._rows = np.vstack([self._rows, own]) if len(self._pose) else own.copy()
        self._pose = np.concatenate([self._pose, state.world_T_imu[None]])
        self._error = np.concatenate([self._error, np.zeros(_SIZE)])
        self._cov = np.concatenate([self._cov, own[None, :, POSE]])
        self._newest += 1
        self._reader.take(self._newest, self._read)

    def poses(self) -> dict[int, Poses]:
        """Poses of all frames by their lag, after the last frame."""
        return self._reader.finish(self._read)

    def _read(self, k: int, with_cov: bool) -> tuple[Array, Array | None]:
        """Smoothed pose ``(4, 4)`` of one of the last frames, and its covariance ``(6, 6)``."""
        place = len(self._pose) - 1 - (self._newest - k)
        error = self._error[_SIZE * place : _SIZE * (place + 1)]
        return se3.retract(self._pose[place], error), self._cov[place].copy() if with_cov else None

    def _take(self, step: Step) -> None:
        if not len(self._pose):
            return
        if isinstance(step, Correction):
            self._rows = self._told(step)
        elif isinstance(step, Keep):
            self._rows = self._rows[:, step.rows]
        elif isinstance(step, Append):
            of_nav = self._rows[:, : step.by_nav.shape[1]]
            self._rows = np.hstack([self._rows, of_nav @ step.by_nav.T])
        elif isinstance(step, Move):
            nav = len(step.transition)
            self._rows[:, :nav] = self._rows[:, :nav] @ step.transition.T
        elif isinstance(step, Reset):
            if step.rest is not None:
                nav = self._rows.shape[1] - len(step.rest)
                self._rows[:, nav:] += self._rows[:, POSE] @ step.rest.T
            self._rows[:, POSE] = self._rows[:, POSE] @ step.pose.T

    def _told(self, update: Correction) -> Array:
        """Correct the poses by a measurement; return their covariance with the state after it."""
        told = update.tell(self._rows)
        self._error = self._error + told.correction
        left, right = (part.reshape(-1, _SIZE, part.shape[1]) for part in (told.left, told.right))
        self._cov = self._cov - left @ right.transpose(0, 2, 1)
        return told.rows
