"""Smooth trajectories: the pose of the body at any time."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from vislam.base.types import Array
from vislam.geometry import se3, so3
from vislam.simulation.settings import SimulationConfig
from vislam.simulation.shapes import shape

_REAR_AXLE = 1.0
"""Distance of the body frame's origin ahead of the point that moves straight ahead [m]."""
_FINE = 20
"""Integration steps of the plane path per frame."""


class BodyPath(Protocol):
    """What a simulation needs of a path: functions of times ``(n,)`` [s]."""

    def pose(self, time: Array) -> Array:
        """World pose ``(n, 4, 4)`` of the body."""
        ...

    def twist(self, time: Array) -> Array:
        """Body twist ``(n, 6)`` (omega, v) [rad/s, m/s]."""
        ...

    def vertical_velocity(self, time: Array) -> Array:
        """Rate of the height ``(n,)`` [m/s]."""
        ...


def central_twist(pose: Callable[[Array], Array], time: Array) -> Array:
    """Body twist ``(n, 6)`` at times ``(n,)``, by central differences of the pose over 2 ms."""
    half = 1e-3
    return se3.local(pose(time - half), pose(time + half)) / (2.0 * half)


class DrivePath:
    """World pose of the body along a trajectory.

    Heading and speed are smooth functions of time; the position is their integral, by Simpson's rule
    on a grid far finer than the frames, so a pose is the same function of time wherever it is asked.
    """

    def __init__(self, config: SimulationConfig, generator: np.random.Generator) -> None:
        self._config = config
        self._phases = generator.uniform(0.0, 2.0 * np.pi, size=8)
        self._shape = shape(config, self._phases, generator)
        margin = 1.0
        grid = np.arange(-margin, config.frames * config.period + margin, config.period / _FINE)
        middle = grid[:-1] + 0.5 * np.diff(grid)
        step = np.diff(grid)[:, None]
        flow = (self._flow(grid[:-1]) + 4.0 * self._flow(middle) + self._flow(grid[1:])) / 6.0
        self._grid = grid
        self._driven = np.concatenate([np.zeros((1, 3)), np.cumsum(flow * step, axis=0)])

    def pose(self, time: Array) -> Array:
        """World pose ``(n, 4, 4)`` of the body at times ``(n,)`` [s], within a second of the trajectory."""
        heading = self._shape.heading(time)
        driven = self._driven_at(time)
        ahead = np.column_stack([np.cos(heading), np.sin(heading)])
        height, slope = self._height(time, driven[:, 2])
        swaying = self._progress(time, driven[:, 2])
        pitch = -np.arctan(slope) + 0.004 * np.sin(2.1 * swaying + self._phases[6])
        roll = 0.006 * np.sin(1.3 * swaying + self._phases[7])
        rotation = (
            so3.exp(heading[:, None] * np.array([0.0, 0.0, 1.0]))
            @ so3.exp(pitch[:, None] * np.array([0.0, 1.0, 0.0]))
            @ so3.exp(roll[:, None] * np.array([1.0, 0.0, 0.0]))
        )
        position = np.column_stack([driven[:, :2] + _REAR_AXLE * ahead, height])
        return se3.from_rotation_translation(rotation, position)

    def twist(self, time: Array) -> Array:
        """Body twist ``(n, 6)`` at times ``(n,)``, by central differences of the pose over 2 ms."""
        return central_twist(self.pose, time)

    def vertical_velocity(self, time: Array) -> Array:
        """Rate of the height ``(n,)`` at times ``(n,)`` [m/s]."""
        half = 1e-3
        ends = [self._height(at, self._driven_at(at)[:, 2])[0] for at in (time - half, time + half)]
        return np.asarray((ends[1] - ends[0]) / (2.0 * half))

    def _driven_at(self, time: Array) -> Array:
        """Place in the plane and way driven ``(n, 3)`` [m]."""
        nearest = np.clip(np.searchsorted(self._grid, time), 1, len(self._grid) - 1) - 1
        since = time - self._grid[nearest]
        half = self._grid[nearest] + 0.5 * since
        flow = (self._flow(self._grid[nearest]) + 4.0 * self._flow(half) + self._flow(time)) / 6.0
        return np.asarray(self._driven[nearest] + flow * since[:, None])

    def _flow(self, time: Array) -> Array:
        """Rates ``(n, 3)`` of place and way [m/s]."""
        heading = self._shape.heading(time)
        along = np.column_stack([np.cos(heading), np.sin(heading), np.ones_like(heading)])
        return self._speed(time)[:, None] * along

    def _speed(self, time: Array) -> Array:
        return np.asarray(self._config.speed * self._shape.pace(time))

    def _progress(self, time: Array, way: Array) -> Array:
        """What hills and sway go by [s]: the time, or the time that the way takes at the configured speed."""
        return way / self._config.speed if self._shape.by_way else time

    def _height(self, time: Array, way: Array) -> tuple[Array, Array]:
        """Height [m] and its slope against the way driven."""
        amplitude = self._config.hills_m
        rate = np.array([0.11, 0.05])
        phase = rate * self._progress(time, way)[:, None] + self._phases[4:6]
        share = np.array([0.5, 0.5])
        height = amplitude * (np.sin(phase) * share).sum(axis=1)
        rise = amplitude * (np.cos(phase) * share * rate).sum(axis=1)
        if not self._shape.by_way:
            return np.asarray(height), np.asarray(rise / self._speed(time))
        grade = self._shape.grade
        return np.asarray(height + grade * way), np.asarray(rise / self._config.speed + grade)
