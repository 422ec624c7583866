"""The joint state of the filter; the one module that edits the joint covariance."""

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from vislam.errors import DivergedError
from vislam.geometry import se3
from vislam.motion import BIAS, NAV, POSE
from vislam.types import Array, BoolArray, IntArray


class JointState:
    """Pose, twist bias and landmarks with their joint covariance.

    The error is ordered (pose, bias, landmark 0, landmark 1, ...): pose (omega, v) on the right,
    bias and landmarks (world, [m]) additive.
    """

    def __init__(self, *, pose_sigma: Array, bias: Array, bias_sigma: Array) -> None:
        self.world_T_imu = np.eye(4)
        self.bias = bias.copy()
        self.track: IntArray = np.empty(0, np.int64)
        self.points: Array = np.empty((0, 3))
        self.cov: Array = np.diag(np.concatenate([pose_sigma, bias_sigma]) ** 2)

    def landmark_cov(self) -> Array:
        """Marginal covariances of the landmarks, ``(n, 3, 3)``."""
        n = len(self.track)
        blocks = self.cov[NAV:, NAV:].reshape(n, 3, n, 3)
        return np.array(blocks[np.arange(n), :, np.arange(n), :])

    def predict(self, prev_T_next: Array, transition: Array, noise: Array) -> None:
        """Move the pose by a step; ``F P F^T + Q`` on the navigation block (eq. 25)."""
        self.world_T_imu = self.world_T_imu @ prev_T_next
        self.cov[:NAV, NAV:] = transition @ self.cov[:NAV, NAV:]
        self.cov[NAV:, :NAV] = self.cov[:NAV, NAV:].T
        self.cov[:NAV, :NAV] = transition @ self.cov[:NAV, :NAV] @ transition.T + noise

    def update(self, cross: Array, innovation_cov: Array, innovation: Array) -> float:
        """Kalman update (eq. 29) from ``P H^T (d, m)``, ``S (m, m)`` and the innovation ``(m,)``.

        With the Cholesky factor L of S, the covariance loses ``W^T W`` with ``W = L^-1 H P``, which
        keeps it symmetric.

        Returns
        -------
        float
            Normalised innovation squared.
        """
        try:
            factor = cholesky(innovation_cov, lower=True, check_finite=False)
        except np.linalg.LinAlgError:
            smallest = float(np.linalg.eigvalsh(innovation_cov)[0])
            raise DivergedError(f"innovation covariance lost, smallest eigenvalue {smallest:.3g}") from None
        whitened = solve_triangular(factor, innovation, lower=True, check_finite=False)
        gain = solve_triangular(factor, cross.T, lower=True, check_finite=False)
        self.cov -= gain.T @ gain
        smallest = float(np.diagonal(self.cov).min())
        if not smallest > 0:
            raise DivergedError(f"covariance lost, smallest variance {smallest:.3g}")
        self._retract(gain.T @ whitened)
        return float(whitened @ whitened)

    def augment(
        self, track: IntArray, points: Array, *, by_pose: Array, by_measurement: Array, noise: Array
    ) -> None:
        """Append landmarks that are functions of pose and measurement.

        Parameters
        ----------
        track : (n,)
        points : (n, 3)
        by_pose : (n, 3, 6)
            Derivative with respect to the pose error.
        by_measurement : (n, 3, 3)
            Derivative with respect to the measurement.
        noise : (n, 3)
            Variances of the measurement [px^2].
        """
        n, size = len(track), len(self.cov)
        jacobian = by_pose.reshape(3 * n, 6)
        cross = jacobian @ self.cov[POSE]
        own = (cross[:, POSE] @ jacobian.T).reshape(n, 3, n, 3)
        spread = (by_measurement * noise[:, None, :]) @ by_measurement.transpose(0, 2, 1)
        own[np.arange(n), :, np.arange(n), :] += spread
        cov = np.empty((size + 3 * n, size + 3 * n))
        cov[:size, :size] = self.cov
        cov[size:, :size] = cross
        cov[:size, size:] = cross.T
        cov[size:, size:] = own.reshape(3 * n, 3 * n)
        self.cov = cov
        self.track = np.concatenate([self.track, track])
        self.points = np.concatenate([self.points, points])

    def keep(self, mask: BoolArray) -> None:
        """Marginalise the landmarks outside the mask ``(n,)``: their rows and columns go."""
        rows = np.concatenate([np.ones(NAV, bool), np.repeat(mask, 3)])
        self.cov = self.cov[np.ix_(rows, rows)]
        self.track, self.points = self.track[mask], self.points[mask]

    def _retract(self, error: Array) -> None:
        self.world_T_imu = se3.retract(self.world_T_imu, error[POSE])
        self.bias = self.bias + error[BIAS]
        self.points = self.points + error[NAV:].reshape(-1, 3)
