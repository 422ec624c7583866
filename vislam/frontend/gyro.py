"""Turns of the camera by a gyro, whose bias is learnt from what the tracks say: a prediction and no more."""

from collections import deque

import numpy as np

from vislam.base.types import Array
from vislam.core.images import Inertia
from vislam.geometry import so3

_REMEMBERED = 25
"""Steps from which the bias is taken, as their median."""
_LONGEST_GAP = 0.5
"""Between samples [s]; over a longer one nothing is predicted but that the camera does not turn."""


class Turns:
    """Mean angular velocity of the camera over a step, less the bias of late.

    Parameters
    ----------
    inertia : Inertia
    imu_R_cam : (3, 3)
        Axes of the rectified left camera in the body.
    """

    def __init__(self, inertia: Inertia, *, imu_R_cam: Array) -> None:
        self._stamp = inertia.stamp
        rate = inertia.gyro @ imu_R_cam
        step = np.diff(inertia.stamp)[:, None]
        self._angle = np.vstack([np.zeros(3), np.cumsum(0.5 * (rate[1:] + rate[:-1]) * step, axis=0)])
        self._errors: deque[Array] = deque(maxlen=_REMEMBERED)

    def between(self, start: float, end: float) -> Array:
        """Rotation ``start_R_end (3, 3)`` of the camera from one stamp to another [s]."""
        rate = self._rate(start, end)
        if rate is None:
            return np.eye(3)
        return so3.exp((rate - self._bias()) * (end - start))

    def learn(self, start: float, end: float, rotation: Array) -> None:
        """Take the rotation ``start_R_end (3, 3)`` that the tracks have found."""
        rate = self._rate(start, end)
        if rate is not None:
            self._errors.append(rate - so3.log(rotation) / (end - start))

    def _bias(self) -> Array:
        return np.median(self._errors, axis=0) if self._errors else np.zeros(3)

    def _rate(self, start: float, end: float) -> Array | None:
        """Mean rate ``(3,)`` of the samples between two stamps; None where there are none."""
        inside = self._stamp[0] - _LONGEST_GAP <= start and end <= self._stamp[-1] + _LONGEST_GAP
        after = int(np.clip(np.searchsorted(self._stamp, end), 1, len(self._stamp) - 1))
        if not inside or self._stamp[after] - self._stamp[after - 1] > _LONGEST_GAP:
            return None
        angle = [np.interp([start, end], self._stamp, axis) for axis in self._angle.T]
        return np.array([(one[1] - one[0]) / (end - start) for one in angle])
