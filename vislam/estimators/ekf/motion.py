"""Models of motion as the filter takes them: blocks of the navigation state, a step, what is measured.

The filter knows of its navigation state only the pose and, for the camera, the offset of the disparities.
Every other block belongs to the model of motion, which predicts it and may measure it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from vislam.base.types import Array
from vislam.core.estimator import HEIGHT_SIGMA, UNKNOWN_CLIMB, Problem
from vislam.core.sequence import Frame
from vislam.estimators.ekf.layout import NavLayout
from vislam.geometry import so3
from vislam.models import odometry
from vislam.models.odometry import POSE


@dataclass(frozen=True)
class Block:
    """Prior of a block of the navigation state; ``sigma (m,)`` are its standard deviations."""

    mean: Array
    sigma: Array


@dataclass(frozen=True)
class Propagation:
    """What a step makes of the navigation state.

    Attributes
    ----------
    prev_T_next : (4, 4)
        The motion of the pose.
    change : (d,)
        What is added to the other blocks; of the pose it is not used.
    transition, noise : (d, d)
        F and Q of the error.
    """

    prev_T_next: Array
    change: Array
    transition: Array
    noise: Array


@dataclass(frozen=True)
class Measurement:
    """A measurement of the navigation state alone.

    Attributes
    ----------
    innovation : (m,)
    by_nav : (m, d)
    variance : (m,)
    """

    innovation: Array
    by_nav: Array
    variance: Array


class Motion(Protocol):
    """A model of motion."""

    def blocks(self) -> Mapping[str, Block]:
        """Blocks that it needs behind the pose, with their priors."""
        ...

    def propagate(self, layout: NavLayout, nav: Array, frame: Frame) -> Propagation:
        """Step to a frame from the navigation state ``nav (d,)`` at the one before."""
        ...

    def measurements(
        self, layout: NavLayout, world_T_imu: Array, nav: Array, frame: Frame
    ) -> Sequence[Measurement]:
        """What is measured at a frame besides the tracks."""
        ...

    def up(self, layout: NavLayout, nav: Array) -> Array | None:
        """Direction ``(3,)`` of up in the world, if it is known better than by the z axis."""
        ...


class OdometryMotion:
    """The recorded twist less its bias (:mod:`vislam.models.odometry`), its clock, and the climb rate.

    Blocks: ``twist_bias`` (6) [rad/s, m/s]; ``clock`` (1), how much later the inertial stamps are than taken
    for [s], where its prior is not zero; where the climb rate is in use ``tilt`` (2), the turn of the true
    vertical against the world's z axis about x and y [rad], and ``climb`` (1), the integrated climb rate [m].
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem

    def blocks(self) -> Mapping[str, Block]:
        """Blocks in use."""
        problem = self._problem
        found = {"twist_bias": Block(problem.bias_mean, np.asarray(problem.bias_sigma))}
        if problem.clock_sigma > 0.0:
            found["clock"] = Block(np.zeros(1), np.array([problem.clock_sigma]))
        if problem.climb is not None:
            found["tilt"] = Block(np.zeros(2), np.full(2, problem.climb.tilt_sigma))
            found["climb"] = Block(np.zeros(1), np.zeros(1))
        return found

    def propagate(self, layout: NavLayout, nav: Array, frame: Frame) -> Propagation:
        """Integrate the twist less its bias, and the climb rate."""
        problem, dt, bias = self._problem, frame.dt, layout["twist_bias"]
        change = np.zeros(layout.size)
        transition, noise = np.eye(layout.size), np.zeros((layout.size, layout.size))
        late = float(nav[layout["clock"]][0]) / dt if "clock" in layout else 0.0
        step = odometry.integrate(
            frame.twist + late * frame.twist_change, bias=nav[bias], dt=dt, noise=problem.noise
        )
        own = slice(0, odometry.NAV)
        transition[own, own], noise[own, own] = odometry.transition(step)
        if "clock" in layout:
            transition[POSE, layout["clock"]] = -(step.by_bias @ frame.twist_change / dt)[:, None]
        if problem.climb is not None:
            known, climb = np.isfinite(frame.climb_rate), layout["climb"]
            change[climb] = dt * frame.climb_rate if known else 0.0
            noise[climb, climb] = dt * problem.climb.walk**2 if known else (dt * UNKNOWN_CLIMB) ** 2
        return Propagation(step.prev_T_next, change, transition, noise)

    def measurements(
        self, layout: NavLayout, world_T_imu: Array, nav: Array, frame: Frame
    ) -> Sequence[Measurement]:
        """Tell that the pose is as high above the start as the climb rate has led."""
        del frame
        if self._problem.climb is None:
            return ()
        up, by_tilt = up_axis(nav[layout["tilt"]])
        position = world_T_imu[:3, 3]
        by_nav = np.zeros((1, layout.size))
        by_nav[0, 3:6] = up @ world_T_imu[:3, :3]
        by_nav[0, layout["tilt"]] = position @ by_tilt
        by_nav[0, layout["climb"]] = -1.0
        return (Measurement(nav[layout["climb"]] - up @ position, by_nav, np.array([HEIGHT_SIGMA**2])),)

    def up(self, layout: NavLayout, nav: Array) -> Array | None:
        """Tell up by the tilt, where it is estimated."""
        return None if self._problem.climb is None else up_axis(nav[layout["tilt"]])[0]


def up_axis(tilt: Array) -> tuple[Array, Array]:
    """Up ``(3,)`` in a world tilted by ``(2,)`` [rad] about x and y, and its derivative ``(3, 2)``."""
    omega = np.array([tilt[0], tilt[1], 0.0])
    up = so3.exp(omega)[:, 2]
    return up, (-so3.hat(up) @ so3.left_jacobian(omega))[:, :2]
