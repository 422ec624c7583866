"""Data with an error that all observations share taken for another: constants of rig, clock and velocity.

Noise of a track averages out over many tracks; these do not. Each parameter has a nominal value, which the
estimators are given. :func:`moved` gives the same data with another value taken for it, so that the change of
an estimate is its sensitivity to the parameter, whatever the estimator.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array
from vislam.core.sequence import Sequence
from vislam.models import odometry
from vislam.models.shared_errors import (
    CAMERA_ROTATION,
    CLOCK,
    DISPARITY_OFFSET,
    FOCAL_SCALE,
    PRINCIPAL_POINT,
    UNITS,
    VELOCITY_DIRECTION,
    CameraErrors,
)


@dataclass(frozen=True)
class Parameter:
    """A constant that all observations share.

    Attributes
    ----------
    components : tuple of str
        What each of its numbers is.
    unit : str
        Empty for a plain number.
    taken : callable
        Sequence with the parameter ``(m,)`` larger than nominal, from the sequence and the difference.
    """

    components: tuple[str, ...]
    unit: str
    taken: Callable[[Sequence, Array], Sequence]


def _of_rig(name: str) -> Callable[[Sequence, Array], Sequence]:
    """How the rig is with one of the errors of :class:`~vislam.models.shared_errors.CameraErrors`."""

    def taken(sequence: Sequence, value: Array) -> Sequence:
        return replace(sequence, rig=CameraErrors.of({name: value}).rig(sequence.rig))

    return taken


def _disparity_offset(sequence: Sequence, offset: Array) -> Sequence:
    """Take the disparities for too large by so much; the left column stays."""
    pixels = sequence.pixels.copy()
    pixels[:, 2] += offset[0]
    return replace(sequence, pixels=pixels)


def _clock(sequence: Sequence, late: Array) -> Sequence:
    return replace(sequence, clock_offset=sequence.clock_offset + float(late[0]))


def _velocity_direction(sequence: Sequence, direction: Array) -> Sequence:
    """Take the recorded velocity for off by its forward component times the direction."""
    twist = sequence.twist - sequence.twist[:, 3:4] * (odometry.ACROSS @ direction)
    return replace(sequence, twist=twist)


def _rate_direction(sequence: Sequence, direction: Array) -> Sequence:
    """Take the recorded roll and pitch rates for off by the yaw rate times the direction."""
    twist = sequence.twist.copy()
    twist[:, :2] -= sequence.twist[:, 2:3] * direction
    return replace(sequence, twist=twist)


def _tracker_bias(sequence: Sequence, bias: Array) -> Sequence:
    """Take all tracks for moved away from their points by so much a frame, as long as they are followed.

    The third component turns both images about their principal points, from column to row, and is what a
    point at a distance of the focal length moves by: as an angle, each component turns the cameras alike.
    """
    rig = sequence.rig
    age = sequence.age()[:, None]
    center, focal = np.array([rig.cx, rig.cy]), np.array([rig.fx, rig.fy])
    x, y = np.moveaxis((sequence.pixels.reshape(-1, 2, 2) - center) / focal, -1, 0)
    angle = age * bias[2] / np.sqrt(rig.fx * rig.fy)
    less, sine = 1.0 - np.cos(angle), np.sin(angle)
    away = age[:, :, None] * bias[:2] + focal * np.stack([less * x - sine * y, less * y + sine * x], axis=-1)
    return replace(sequence, pixels=sequence.pixels - away.reshape(-1, 4))


PARAMETERS: Mapping[str, Parameter] = {
    CAMERA_ROTATION: Parameter(("x", "y", "z"), UNITS[CAMERA_ROTATION], _of_rig(CAMERA_ROTATION)),
    DISPARITY_OFFSET: Parameter(("",), UNITS[DISPARITY_OFFSET], _disparity_offset),
    PRINCIPAL_POINT: Parameter(("column", "row"), UNITS[PRINCIPAL_POINT], _of_rig(PRINCIPAL_POINT)),
    FOCAL_SCALE: Parameter(("",), UNITS[FOCAL_SCALE], _of_rig(FOCAL_SCALE)),
    CLOCK: Parameter(("",), UNITS[CLOCK], _clock),
    VELOCITY_DIRECTION: Parameter(("left", "up"), UNITS[VELOCITY_DIRECTION], _velocity_direction),
    "rate_direction": Parameter(("roll", "pitch"), "rad", _rate_direction),
    "tracker_bias": Parameter(("column", "row", "turn"), "px/frame", _tracker_bias),
}
"""The parameters by name, those that can be estimated as :mod:`vislam.models.shared_errors` has them; the
cameras turn about the axes of the body."""


def component_name(parameter: str, index: int) -> str:
    """Name of a component, such as ``camera_rotation_x``."""
    return "_".join(filter(None, (parameter, PARAMETERS[parameter].components[index])))


def moved(sequence: Sequence, parameter: str, *, index: int, amount: float) -> Sequence:
    """Return the sequence with a component of a parameter taken for larger than nominal by an amount.

    The observations, their tracks and all cuts stay, so that what an estimator makes of it differs by the
    parameter alone.

    Parameters
    ----------
    sequence : Sequence
    parameter : str
        Of :data:`PARAMETERS`.
    index : int
        Which of its components.
    amount : float
        In the unit of the parameter.
    """
    kind = PARAMETERS[parameter]
    difference = np.zeros(len(kind.components))
    difference[index] = amount
    return kind.taken(sequence, difference)
