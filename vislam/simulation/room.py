"""A hovering body in a room: slow oscillations along and about all axes."""

import numpy as np

from vislam.base.types import Array
from vislam.geometry import se3, so3
from vislam.simulation.path import central_twist
from vislam.simulation.settings import SimulationConfig

_SIDES = np.array([3.0, 2.0, 0.8])
"""Half the sides of the room [m]."""
_PACE = np.array([1.0, 1.37, 1.91])
"""Of the oscillations along its sides, as a share of the first one's."""
_TURNS = np.array([0.12, 0.10, 0.9])
"""Amplitudes of roll, pitch and yaw [rad]."""
_TURN_RATE = np.array([1.9, 2.3, 0.7])
"""Their rates [rad/s]."""


class RoomPath:
    """World pose of the body: sums of sines along and about its axes."""

    def __init__(self, config: SimulationConfig, generator: np.random.Generator) -> None:
        self._rate = config.speed / _SIDES[0] * _PACE
        self._phase = generator.uniform(0.0, 2.0 * np.pi, size=(2, 3))

    def pose(self, time: Array) -> Array:
        """World pose ``(n, 4, 4)`` of the body at times ``(n,)`` [s]."""
        place = _SIDES * np.sin(np.outer(time, self._rate) + self._phase[0])
        roll, pitch, yaw = (_TURNS * np.sin(np.outer(time, _TURN_RATE) + self._phase[1])).T
        x, y, z = np.eye(3)
        rotation = so3.exp(yaw[:, None] * z) @ so3.exp(pitch[:, None] * y) @ so3.exp(roll[:, None] * x)
        return se3.from_rotation_translation(rotation, place)

    def twist(self, time: Array) -> Array:
        """Body twist ``(n, 6)`` at times ``(n,)``, by central differences of the pose."""
        return central_twist(self.pose, time)

    def vertical_velocity(self, time: Array) -> Array:
        """Rate of the height ``(n,)`` at times ``(n,)`` [m/s]."""
        rate, phase = self._rate[2], self._phase[0, 2]
        return np.asarray(_SIDES[2] * rate * np.cos(rate * time + phase))
