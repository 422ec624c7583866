"""States between two that are known, by the inertia between them.

From a state i that is given, the preintegrated steps lead to a prediction at each frame m and at the next
known state j, with errors ``e_m`` and ``e_j`` whose covariances are

    P_m = F_m P_{m-1} F_m^T + Q_m,    P_i = 0,    cov(e_m, e_j) = P_m (F_j ... F_{m+1})^T,

so that what is known of j moves the state at m by ``cov(e_m, e_j) P_j^-1 (x_j - x_j^predicted)``: the mean of
what both neighbours say, to first order (Rauch, Tung and Striebel, AIAA Journal 3, 1965). Nothing else tells
of a frame without observations, whatever is observed elsewhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.geometry import se3
from vislam.models.imu import IMU_NAV
from vislam.models.preintegration import Preintegrated

_POSE, _VELOCITY, _GYRO, _ACCEL = slice(0, 6), slice(6, 9), slice(9, 12), slice(12, 15)
_NOTHING = 1e-12
"""Share of the largest eigenvalue of correlations below which a direction is without noise."""


@dataclass(frozen=True)
class InertialState:
    """Pose, velocity and biases.

    Attributes
    ----------
    pose : (4, 4)
        ``world_T_imu``.
    velocity : (3,)
        In the world [m/s].
    gyro_bias, accel_bias : (3,)
        [rad/s], [m/s^2].
    """

    pose: Array
    velocity: Array
    gyro_bias: Array
    accel_bias: Array

    def predicted(self, step: Preintegrated, gravity: Array) -> "InertialState":
        """State at the end of a step."""
        pose, velocity = step.predict(self.pose, self.velocity, gravity)
        return InertialState(pose, velocity, self.gyro_bias, self.accel_bias)

    def moved(self, error: Array) -> "InertialState":
        """State with an error ``(15,)`` added: of the pose on its right, of all else by sums."""
        return InertialState(
            se3.retract(self.pose, error[_POSE]),
            self.velocity + error[_VELOCITY],
            self.gyro_bias + error[_GYRO],
            self.accel_bias + error[_ACCEL],
        )

    def to(self, other: "InertialState") -> Array:
        """Error ``(15,)`` that moves it to another."""
        return np.concatenate(
            [
                se3.local(self.pose, other.pose),
                other.velocity - self.velocity,
                other.gyro_bias - self.gyro_bias,
                other.accel_bias - self.accel_bias,
            ]
        )


def fill_gap(
    before: InertialState, after: InertialState | None, steps: Sequence[Preintegrated], gravity: Array
) -> list[InertialState]:
    """States at the ends of all steps but that of the last one, at which ``after`` is.

    Parameters
    ----------
    before, after : InertialState
        Known at the beginning of the first step and at the end of the last. None: nothing is known there,
        and the states at the ends of all steps are predictions.
    steps : sequence of Preintegrated
        At the biases of ``before``.
    gravity : (3,)
        In the world [m/s^2].
    """
    states, transitions, covs = [before], [], [np.zeros((IMU_NAV, IMU_NAV))]
    for step in steps:
        transition, noise = step.linear(states[-1].pose[:3, :3])
        states.append(states[-1].predicted(step, gravity))
        transitions.append(transition)
        covs.append(transition @ covs[-1] @ transition.T + noise)
    if after is None:
        return states[1:]
    weighted = _solved(covs[-1], states[-1].to(after))
    found = []
    for state, cov, transition in zip(states[-2:0:-1], covs[-2:0:-1], transitions[:0:-1], strict=True):
        weighted = transition.T @ weighted
        found.append(state.moved(cov @ weighted))
    return found[::-1]


def _solved(cov: Array, error: Array) -> Array:
    """``cov^-1 error``, along the directions in which there is noise."""
    sigma = np.sqrt(np.diagonal(cov))
    scale = np.divide(1.0, sigma, out=np.zeros_like(sigma), where=sigma > 0.0)
    inverse = np.linalg.pinv(scale[:, None] * cov * scale, rcond=_NOTHING, hermitian=True)
    return np.asarray(scale * (inverse @ (scale * error)))
