"""The textbook joint filter over all landmarks, every matrix formed: the reference to read and test against.

Slow on purpose. Equation numbers are the report's (section III-D); its slips are mended where named.
"""

from collections.abc import Sequence

import numpy as np

from vislam import motion
from vislam.data.sequence import Frame
from vislam.ekf import measurement
from vislam.ekf.state import LANDMARK
from vislam.estimator import Problem
from vislam.geometry import se3
from vislam.motion import BIAS, NAV, POSE
from vislam.types import Array


class DenseFilter:
    """Joint EKF that keeps every landmark for ever and gates nothing.

    Attributes
    ----------
    world_T_imu : (4, 4)
    bias : (6,)
    landmarks : (m, 4)
        All landmarks so far (point and error of its match), in the order of ``track``.
    cov : (12 + 4m, 12 + 4m)
        Covariance of (pose, bias, landmarks).
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self.world_T_imu = np.eye(4)
        self.bias = problem.bias_mean.copy()
        self.track: list[int] = []
        self.landmarks = np.empty((0, LANDMARK))
        self.cov = np.diag(np.concatenate([problem.first_pose_sigma, problem.bias_sigma]) ** 2)

    def process(self, frame: Frame) -> None:
        """Predict, update with all known landmarks at once, append the new ones."""
        if frame.k > 0:
            self._predict(frame)
        known = [row for row, track in enumerate(frame.track) if int(track) in self.track]
        if known:
            self._drift(frame, known)
            self._update(frame, known)
        for row in range(len(frame.track)):
            if int(frame.track[row]) not in self.track:
                self._append(frame, row)

    def _predict(self, frame: Frame) -> None:
        step = motion.integrate(frame.twist, bias=self.bias, dt=frame.dt, noise=self._problem.noise)
        block, noise = motion.transition(step)
        transition = np.eye(len(self.cov))
        transition[:NAV, :NAV] = block
        self.world_T_imu = self.world_T_imu @ step.prev_T_next
        self.cov = transition @ self.cov @ transition.T
        self.cov[:NAV, :NAV] += noise

    def _drift(self, frame: Frame, rows: Sequence[int]) -> None:
        """Let the points of the tracks in view walk, column and row."""
        for row in rows:
            slot = self.track.index(int(frame.track[row]))
            step = measurement.drift_cov(
                self._problem.rig,
                self.world_T_imu,
                self.landmarks[slot : slot + 1, :3],
                drift=self._problem.track_noise.drift,
            )
            place = slice(NAV + LANDMARK * slot, NAV + LANDMARK * slot + 3)
            self.cov[place, place] += step[0]

    def _update(self, frame: Frame, rows: Sequence[int]) -> None:
        """Eqs. (28) and (29), with the sign and the inverse that eq. (26) lacks."""
        slots = [self.track.index(int(frame.track[row])) for row in rows]
        found = measurement.predict(self._problem.rig, self.world_T_imu, self.landmarks[slots])
        jacobian = np.zeros((3 * len(rows), len(self.cov)))
        for place, slot in enumerate(slots):
            jacobian[3 * place : 3 * place + 3, POSE] = found.by_pose[place]
            column = NAV + LANDMARK * slot
            jacobian[3 * place : 3 * place + 3, column : column + LANDMARK] = found.by_landmark[place]
        noise = np.diag(np.tile(self._problem.track_noise.sigma**2, len(rows)))
        spread = jacobian @ self.cov @ jacobian.T + noise
        gain = np.linalg.solve(spread, jacobian @ self.cov).T
        self._retract(gain @ (frame.z[list(rows)] - found.z).ravel())
        self.cov = (np.eye(len(self.cov)) - gain @ jacobian) @ self.cov

    def _append(self, frame: Frame, row: int) -> None:
        """Append the landmark of eq. (20), its covariance that of pose and measurement."""
        landmarks, by_pose, by_measurement = measurement.initialise(
            self._problem.rig, self.world_T_imu, frame.z[row : row + 1]
        )
        match = self._problem.track_noise.match_sigma(frame.z[row : row + 1, 0] - frame.z[row : row + 1, 1])
        noise = np.diag(np.concatenate([self._problem.track_noise.sigma, match]) ** 2)
        grow = np.zeros((LANDMARK, len(self.cov)))
        grow[:, POSE] = by_pose[0]
        cross = grow @ self.cov
        own = cross @ grow.T + by_measurement[0] @ noise @ by_measurement[0].T
        self.cov = np.block([[self.cov, cross.T], [cross, own]])
        self.track.append(int(frame.track[row]))
        self.landmarks = np.vstack([self.landmarks, landmarks])

    def _retract(self, error: Array) -> None:
        self.world_T_imu = se3.retract(self.world_T_imu, error[POSE])
        self.bias = self.bias + error[BIAS]
        self.landmarks = self.landmarks + error[NAV:].reshape(-1, LANDMARK)
