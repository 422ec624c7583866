"""Smooth drives in closed form: the pose of the body at any time."""

import numpy as np

from vislam.geometry import se3, so3
from vislam.simulation.settings import SimulationConfig
from vislam.types import Array

_REAR_AXLE = 1.0
"""Distance of the body frame's origin ahead of the point that moves straight ahead [m]."""
_FINE = 20
"""Integration steps of the plane path per frame."""


class DrivePath:
    """World pose of the body along a drive.

    Heading and speed are smooth functions of time; the position is their integral, by Simpson's rule
    on a grid far finer than the frames, so a pose is the same function of time wherever it is asked.
    """

    def __init__(self, config: SimulationConfig, generator: np.random.Generator) -> None:
        self._config = config
        self._duration = config.frames * config.period
        self._phases = generator.uniform(0.0, 2.0 * np.pi, size=8)
        self._turns = self._town_turns(generator)
        self._margin = 1.0
        grid = np.arange(-self._margin, self._duration + self._margin, config.period / _FINE)
        middle = grid[:-1] + 0.5 * np.diff(grid)
        step = np.diff(grid)[:, None]
        flow = (self._velocity(grid[:-1]) + 4.0 * self._velocity(middle) + self._velocity(grid[1:])) / 6.0
        self._grid = grid
        self._plane = np.concatenate([np.zeros((1, 2)), np.cumsum(flow * step, axis=0)])

    def pose(self, time: Array) -> Array:
        """World pose ``(n, 4, 4)`` of the body at times ``(n,)`` [s], within a second of the drive."""
        heading = self._heading(time)
        nearest = np.clip(np.searchsorted(self._grid, time), 1, len(self._grid) - 1) - 1
        since = time - self._grid[nearest]
        half = self._grid[nearest] + 0.5 * since
        flow = (self._velocity(self._grid[nearest]) + 4.0 * self._velocity(half) + self._velocity(time)) / 6.0
        plane = self._plane[nearest] + flow * since[:, None]
        ahead = np.column_stack([np.cos(heading), np.sin(heading)])
        height, slope = self._height(time)
        pitch = -np.arctan(slope) + 0.004 * np.sin(2.1 * time + self._phases[6])
        roll = 0.006 * np.sin(1.3 * time + self._phases[7])
        rotation = (
            so3.exp(heading[:, None] * np.array([0.0, 0.0, 1.0]))
            @ so3.exp(pitch[:, None] * np.array([0.0, 1.0, 0.0]))
            @ so3.exp(roll[:, None] * np.array([1.0, 0.0, 0.0]))
        )
        position = np.column_stack([plane + _REAR_AXLE * ahead, height])
        return se3.from_rotation_translation(rotation, position)

    def twist(self, time: Array) -> Array:
        """Body twist ``(n, 6)`` at times ``(n,)``, by central differences of the pose over 2 ms."""
        half = 1e-3
        return se3.local(self.pose(time - half), self.pose(time + half)) / (2.0 * half)

    def climb_rate(self, time: Array) -> Array:
        """Rate of the height ``(n,)`` at times ``(n,)`` [m/s]."""
        half = 1e-3
        return np.asarray((self._height(time + half)[0] - self._height(time - half)[0]) / (2.0 * half))

    def _town_turns(self, generator: np.random.Generator) -> Array:
        """Rows of (time, angle, width): the corners that a town drive takes."""
        if self._config.path != "town":
            return np.empty((0, 3))
        times = np.arange(9.0, self._duration + 10.0, 13.0)
        times = times + generator.uniform(-2.0, 2.0, len(times))
        sign = generator.choice([-1.0, 1.0], len(times))
        angle = sign * generator.uniform(0.3, 1.5, len(times))
        return np.column_stack([times, angle, generator.uniform(0.9, 1.5, len(times))])

    def _heading(self, time: Array) -> Array:
        if self._config.path == "loop":
            return np.asarray(2.0 * np.pi * time / self._duration)
        wave = 0.04 * np.sin(0.23 * time + self._phases[0]) + 0.02 * np.sin(0.71 * time + self._phases[1])
        if self._config.path == "straight":
            return np.asarray(wave)
        when, angle, width = self._turns.T
        corners = 0.5 * angle * (1.0 + np.tanh((time[:, None] - when) / width))
        return np.asarray(wave + corners.sum(axis=1))

    def _speed(self, time: Array) -> Array:
        """Speed [m/s]: slower in corners, uneven between them; its mean is the configured one."""
        base = (
            1.0 + 0.15 * np.sin(0.31 * time + self._phases[2]) + 0.08 * np.sin(0.83 * time + self._phases[3])
        )
        if self._config.path == "town":
            when, angle, width = self._turns.T
            slow = 0.35 * np.abs(angle) / 1.5 * np.exp(-(((time[:, None] - when) / (1.5 * width)) ** 2))
            base = base - np.minimum(slow.sum(axis=1), 0.6)
        return np.asarray(self._config.speed * base)

    def _velocity(self, time: Array) -> Array:
        heading = self._heading(time)
        return self._speed(time)[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])

    def _height(self, time: Array) -> tuple[Array, Array]:
        """Height [m] and its slope against the way driven."""
        amplitude = self._config.hills_m
        rate = np.array([0.11, 0.05])
        phase = rate * time[:, None] + self._phases[4:6]
        share = np.array([0.5, 0.5])
        height = amplitude * (np.sin(phase) * share).sum(axis=1)
        climb = amplitude * (np.cos(phase) * share * rate).sum(axis=1)
        return np.asarray(height), np.asarray(climb / self._speed(time))
