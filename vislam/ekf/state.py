"""The joint state of the filter; the one module that edits the joint covariance."""

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from vislam.errors import DivergedError
from vislam.geometry import se3
from vislam.motion import BIAS, NAV, POSE
from vislam.types import Array, BoolArray, IntArray

LANDMARK = 4
"""Size of a landmark: its point in the world [m], and the error of its match (``vislam.sensors.noise``)."""


class JointState:
    """Pose, twist bias and landmarks with their joint covariance.

    The error is ordered (pose, bias, landmark 0, landmark 1, ...): pose (omega, v) on the right,
    bias and landmarks additive.
    """

    def __init__(self, *, pose_sigma: Array, bias: Array, bias_sigma: Array) -> None:
        self.world_T_imu = np.eye(4)
        self.bias = bias.copy()
        self.track: IntArray = np.empty(0, np.int64)
        self.landmarks: Array = np.empty((0, LANDMARK))
        self.cov: Array = np.diag(np.concatenate([pose_sigma, bias_sigma]) ** 2)

    def landmark_cov(self) -> Array:
        """Marginal covariances of the landmarks' points, ``(n, 3, 3)`` [m^2]."""
        each = np.arange(len(self.track))
        return np.array(self._blocks()[each, :3, each, :3])

    def match_variance(self) -> Array:
        """Variances of the landmarks' match errors, ``(n,)``."""
        return np.array(np.diagonal(self.cov)[NAV + LANDMARK - 1 :: LANDMARK])

    def predict(self, prev_T_next: Array, transition: Array, noise: Array) -> None:
        """Move the pose by a step; ``F P F^T + Q`` on the navigation block (eq. 25)."""
        self.world_T_imu = self.world_T_imu @ prev_T_next
        self.cov[:NAV, NAV:] = transition @ self.cov[:NAV, NAV:]
        self.cov[NAV:, :NAV] = self.cov[:NAV, NAV:].T
        self.cov[:NAV, :NAV] = transition @ self.cov[:NAV, :NAV] @ transition.T + noise

    def wander(self, noise: Array) -> None:
        """Let the landmarks' points walk by steps of covariance ``(n, 3, 3)`` [m^2]: their tracks drift."""
        each = np.arange(len(self.track))
        self._blocks()[each, :3, each, :3] += noise

    def update(self, cross: Array, innovation_cov: Array, innovation: Array) -> tuple[float, float]:
        """Kalman update (eq. 29) from ``P H^T (d, m)``, ``S (m, m)`` and the innovation ``(m,)``.

        With the Cholesky factor L of S, the covariance loses ``W^T W`` with ``W = L^-1 H P``, which
        keeps it symmetric.

        Returns
        -------
        nis : float
            Normalised innovation squared.
        log_det : float
            Logarithm of the determinant of S.
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
        return float(whitened @ whitened), 2.0 * float(np.log(np.diagonal(factor)).sum())

    def augment(
        self, track: IntArray, landmarks: Array, *, by_pose: Array, by_measurement: Array, noise: Array
    ) -> None:
        """Append landmarks that are functions of pose and measurement.

        Parameters
        ----------
        track : (n,)
        landmarks : (n, 4)
        by_pose : (n, 4, 6)
            Derivative with respect to the pose error.
        by_measurement : (n, 4, 4)
            Derivative with respect to the measurement and the error of the match.
        noise : (n, 4)
            Variances of the measurement and of the error of the match.
        """
        n, size = len(track), len(self.cov)
        jacobian = by_pose.reshape(LANDMARK * n, 6)
        cross = jacobian @ self.cov[POSE]
        own = (cross[:, POSE] @ jacobian.T).reshape(n, LANDMARK, n, LANDMARK)
        spread = (by_measurement * noise[:, None, :]) @ by_measurement.transpose(0, 2, 1)
        own[np.arange(n), :, np.arange(n), :] += spread
        cov = np.empty((size + LANDMARK * n, size + LANDMARK * n))
        cov[:size, :size] = self.cov
        cov[size:, :size] = cross
        cov[:size, size:] = cross.T
        cov[size:, size:] = own.reshape(LANDMARK * n, LANDMARK * n)
        self.cov = cov
        self.track = np.concatenate([self.track, track])
        self.landmarks = np.concatenate([self.landmarks, landmarks])

    def keep(self, mask: BoolArray) -> None:
        """Marginalise the landmarks outside the mask ``(n,)``: their rows and columns go."""
        rows = np.concatenate([np.ones(NAV, bool), np.repeat(mask, LANDMARK)])
        self.cov = self.cov[np.ix_(rows, rows)]
        self.track, self.landmarks = self.track[mask], self.landmarks[mask]

    def _retract(self, error: Array) -> None:
        self.world_T_imu = se3.retract(self.world_T_imu, error[POSE])
        self.bias = self.bias + error[BIAS]
        self.landmarks = self.landmarks + error[NAV:].reshape(-1, LANDMARK)

    def _blocks(self) -> Array:
        """View ``(n, 4, n, 4)`` of the landmarks' part of the covariance."""
        n = len(self.track)
        return self.cov[NAV:, NAV:].reshape(n, LANDMARK, n, LANDMARK)
