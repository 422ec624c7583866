"""Spurious information of a filter along the unobservable directions.

A rigid motion ``xi`` of the whole world, pose and landmarks together, changes no measurement. As an error of
the state it is a direction ``N xi`` that starts as ``Ad(T^-1) xi`` at the first pose, is passed on by the
filter's linear steps as every other error is (motion, new landmarks, new coordinates of the error, but not
the gain), and which the Jacobians of a consistent filter do not see: ``H N = 0``. What they do see of it is
spurious information, ``N^T H^T R^-1 H N`` an update. Huang, Mourikis and Roumeliotis,
*Observability-based rules for designing consistent EKF SLAM estimators*, IJRR 29 (2010), section 4.
"""

from collections.abc import Iterable

import numpy as np

from vislam.base.types import Array
from vislam.estimators.ekf.layout import NavLayout
from vislam.estimators.ekf.linear import Append, Correction, Keep, Move, Reset, Step
from vislam.geometry import se3
from vislam.models.odometry import POSE


class Unobservable:
    """Follows the motions of the world through the steps of a filter that has not started yet.

    Without gravity among the measurements all six cannot be observed; with it all but the turns about x and
    y, of which nothing is reported.

    Parameters
    ----------
    layout : NavLayout
    world_T_imu : (4, 4)
        First pose.
    nav : (d_nav,)
        First navigation state.

    Attributes
    ----------
    directions : (d, 6)
        The errors of the state that unit motions (omega, v) of the world are.
    """

    def __init__(self, layout: NavLayout, world_T_imu: Array, nav: Array) -> None:
        self._nav = layout.size
        self.directions = unit_motions(layout, world_T_imu, nav)
        self._asked = free_motions(layout)

    def follow(self, steps: Iterable[Step]) -> Array:
        """Follow some steps; return the information ``(6,)`` they gain on each motion [1/rad^2, 1/m^2]."""
        gained = np.zeros(6)
        for step in steps:
            gained += self._take(step)
        return gained

    def _take(self, step: Step) -> Array:
        """Follow one step; a marginalisation of landmarks or a record of the pose changes nothing."""
        held, nav = self.directions, self._nav
        match step:
            case Correction():
                seen = step.jacobian.times(held)
                return np.asarray(np.sum(seen**2 / step.white[:, None], axis=0)) * self._asked
            case Move():
                held[:nav] = step.transition @ held[:nav]
            case Reset():
                if step.rest is not None:
                    held[len(held) - len(step.rest) :] += step.rest @ held[POSE]
                held[POSE] = step.pose @ held[POSE]
            case Append():
                self.directions = np.concatenate([held, step.by_nav @ held[: step.by_nav.shape[1]]])
            case Keep():
                self.directions = held[step.rows]
        return np.zeros(6)


def unit_motions(layout: NavLayout, world_T_imu: Array, nav: Array) -> Array:
    """Errors ``(d_nav, 6)`` of a navigation state that unit motions (omega, v) of the world are."""
    return np.concatenate([se3.adjoint(se3.inverse(world_T_imu)), layout.moved(nav)])


def free_motions(layout: NavLayout) -> Array:
    """Which motions of the world ``(6,)`` nothing observes, 1 or 0; gravity shows turns about x and y."""
    return np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0]) if layout.moves else np.ones(6)
