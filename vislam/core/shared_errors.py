"""Errors that all observations of a sequence share: constants of rig, clock and velocity, taken as others.

Noise of a track averages out over many tracks; these do not. Each parameter has a nominal value, which the
estimators are given. :func:`moved` gives the same data with another value taken for it, so that the change of
an estimate is its sensitivity to the parameter, whatever the estimator.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from vislam.base.types import Array
from vislam.core.sequence import Sequence
from vislam.geometry import se3, so3
from vislam.models import odometry


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


def _camera_rotation(sequence: Sequence, turn: Array) -> Sequence:
    """Turn the camera about its own axes: ``imu_R_cam exp(turn)``."""
    imu_T_cam = sequence.rig.imu_T_cam @ se3.from_rotation_translation(so3.exp(turn), np.zeros(3))
    return replace(sequence, rig=replace(sequence.rig, imu_T_cam=imu_T_cam))


def _disparity_offset(sequence: Sequence, offset: Array) -> Sequence:
    """Take the disparities for too large by so much; the left column stays."""
    pixels = sequence.pixels.copy()
    pixels[:, 2] += offset[0]
    return replace(sequence, pixels=pixels)


def _principal_point(sequence: Sequence, offset: Array) -> Sequence:
    rig = sequence.rig
    return replace(sequence, rig=replace(rig, cx=rig.cx + float(offset[0]), cy=rig.cy + float(offset[1])))


def _focal_scale(sequence: Sequence, share: Array) -> Sequence:
    rig, scale = sequence.rig, 1.0 + float(share[0])
    return replace(sequence, rig=replace(rig, fx=scale * rig.fx, fy=scale * rig.fy))


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


PARAMETERS: Mapping[str, Parameter] = {
    "camera_rotation": Parameter(("x", "y", "z"), "rad", _camera_rotation),
    "disparity_offset": Parameter(("",), "px", _disparity_offset),
    "principal_point": Parameter(("column", "row"), "px", _principal_point),
    "focal_scale": Parameter(("",), "", _focal_scale),
    "clock": Parameter(("",), "s", _clock),
    "velocity_direction": Parameter(("left", "up"), "rad", _velocity_direction),
    "rate_direction": Parameter(("roll", "pitch"), "rad", _rate_direction),
}
"""The parameters by name. The camera's turn is about its own axes (x right, y down, z ahead)."""


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
