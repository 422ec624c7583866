"""Result of an initialisation: the state at the first frame with its covariance, and the account of it."""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.initialisation.settings import InitialisationSettings
from vislam.models.imu import IMU_NAV, ImuPrior

TILT, SPEED, GYRO, ACCEL = slice(0, 2), slice(2, 5), slice(5, 8), slice(8, 11)
"""Parts of the information matrix."""
SIZE = 11


class NotFoundError(ValueError):
    """The data do not tell the first state; the message says what is missing."""


@dataclass(frozen=True)
class Found:
    """State at the first frame.

    Errors are in the order (tilt about the world's x and y, velocity in the world, gyro bias, accelerometer
    bias): the true attitude is ``exp((tilt, 0)) world_R_imu``, all else is additive.

    Attributes
    ----------
    method : str
        ``static`` or ``dynamic``.
    world_R_imu : (3, 3)
    velocity : (3,)
        In the world [m/s].
    gyro_bias, accel_bias : (3,)
        [rad/s], [m/s^2].
    information : (11, 11)
        That of the data alone.
    prior : (11, 11)
        That of what is known of biases without data.
    account : str
        One line: method, window, what was found and how well.
    variance_factor : float
        By what the variances of inertia and tracks were scaled, for their residuals are so much larger; 1
        where they are not.
    """

    method: str
    world_R_imu: Array
    velocity: Array
    gyro_bias: Array
    accel_bias: Array
    information: Array
    prior: Array
    account: str = ""
    variance_factor: float = 1.0

    @property
    def cov(self) -> Array:
        """Covariance ``(11, 11)`` of the error, from data and prior."""
        return np.asarray(np.linalg.inv(self.information + self.prior))

    def as_prior(self, settings: InitialisationSettings) -> ImuPrior:
        """What estimators are given: the same mean, and less information, as they will see the data again."""
        widened = self.prior + self.information / settings.widened**2
        return ImuPrior(
            _pose(self.world_R_imu),
            self.velocity,
            self.gyro_bias,
            self.accel_bias,
            self._full(np.asarray(np.linalg.inv(widened), float), settings),
            self.account,
        )

    def _full(self, cov: Array, settings: InitialisationSettings) -> Array:
        """Covariance ``(15, 15)`` in the order of a prior, the pose's on its right, in the body."""
        by = np.zeros((IMU_NAV, SIZE))
        by[:3, TILT] = self.world_R_imu.T[:, :2]
        by[6:, 2:] = np.eye(9)
        gauge = np.zeros((IMU_NAV, IMU_NAV))
        vertical = self.world_R_imu[2]
        gauge[:3, :3] = settings.gauge_sigma**2 * np.outer(vertical, vertical)
        gauge[3:6, 3:6] = settings.gauge_sigma**2 * np.eye(3)
        return np.asarray(by @ cov @ by.T + gauge)


def bias_prior(settings: InitialisationSettings) -> Array:
    """Information ``(11, 11)`` on the biases that is there without data."""
    sigma = np.repeat([settings.gyro_bias_sigma, settings.accel_bias_sigma], 3)
    return np.diag(np.concatenate([np.zeros(5), sigma**-2.0]))


def _pose(rotation: Array) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = rotation
    return pose
