"""Repairs of the inertial samples: units, clock, and the frames that their components refer to."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from pydantic.dataclasses import dataclass as setting
from scipy.spatial.transform import Rotation

from vislam.base.errors import DataError
from vislam.base.fields import STRICT
from vislam.base.types import Array
from vislam.core.sequence import Sequence
from vislam.models.imu import FORCE_UNITS, RATE_UNITS

_STEEPEST = 1.25
"""Pitch beyond which forward is hardly level [rad]."""


@setting(frozen=True, slots=True, kw_only=True, config=STRICT)
class ImuUnits:
    """Bring raw inertia (accelerometer and gyro) from the units of its file to rad/s and m/s^2."""

    gyro: Literal["rad/s", "deg/s", "mrad/s", "mdeg/s", "rpm"] = "rad/s"
    """Unit of the angular velocity in the file."""
    accel: Literal["m/s^2", "g", "mg", "cm/s^2", "mm/s^2"] = "m/s^2"
    """Unit of the specific force in the file; g is 9.80665 m/s^2."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Divide by them; where no velocity was recorded, the rates of the twist are the gyro's, too."""
        imu = sequence.imu
        if imu is None:
            raise DataError(
                f"data.repair.imu_units: expected an accelerometer and a gyro, {sequence.name} has none; "
                "leave it out"
            )
        gyro, twist = imu.gyro / RATE_UNITS[self.gyro], sequence.twist
        if np.array_equal(twist[:, :3], imu.gyro):
            twist = np.hstack([gyro, twist[:, 3:]])
        scaled = replace(imu, gyro=gyro, accel=imu.accel / FORCE_UNITS[self.accel])
        return replace(sequence, imu=scaled, twist=twist)


@setting(frozen=True, slots=True, kw_only=True, config=STRICT)
class Clock:
    """Move the inertial stamps to the camera's clock."""

    offset: float
    """How late the inertial stamps are against the camera's [s]."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Move them."""
        return replace(sequence, clock_offset=self.offset)


@setting(frozen=True, slots=True, kw_only=True, config=STRICT)
class NavigationFrameVelocity:
    """Take the third velocity component for what it is in a levelled recording, the vertical velocity."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Set the body's own vertical velocity to 0: a car does not move along its own z."""
        twist = sequence.twist.copy()
        vertical_velocity = twist[:, 5].copy()
        twist[:, 5] = 0.0
        return replace(sequence, twist=twist, vertical_velocity=vertical_velocity)


@setting(frozen=True, slots=True, kw_only=True, config=STRICT)
class NavigationFrameRates:
    """Rotate rates about level axes (forward, left, up) into the body's axes.

    Some inertial systems state their rates about the axes of a frame that only turns with the heading. In a
    body that is tilted against it a turn is then missing in roll and pitch, by tilt times yaw rate. The tilt
    follows from the rates themselves, once it is known at the first sample.
    """

    roll: float = 0.0
    """Roll of the body at the first sample, about its forward axis [rad]."""
    pitch: float = 0.0
    """Pitch of the body at the first sample, about its left axis [rad]; positive is nose down."""
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Of the rates [rad/s]; the tilt is integrated without it, and it stays in for the estimators."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Rotate them."""
        bias = np.array(self.bias)
        rates = sequence.twist[:, :3] - bias
        tilt = Tilt.integrated(rates, sequence.inertial_stamp, roll=self.roll, pitch=self.pitch)
        tilt.require_level(sequence.inertial_stamp)
        twist = sequence.twist.copy()
        twist[:, :3] = tilt.in_body(rates) + bias
        return replace(sequence, twist=twist)


@dataclass(frozen=True)
class Tilt:
    """Roll and pitch of a body at each inertial sample.

    Attributes
    ----------
    roll, pitch : (S,)
        [rad].
    """

    roll: Array
    pitch: Array

    @classmethod
    def integrated(cls, rates: Array, stamp: Array, *, roll: float, pitch: float) -> "Tilt":
        """Tilt by rates about level axes.

        With heading, pitch and roll turned in this order, rates about level axes are

            (d roll cos(pitch), d pitch, d heading - d roll sin(pitch)),

        so that pitch and roll are integrals of what is known, one after the other.

        Parameters
        ----------
        rates : (S, 3)
            About forward, left and up [rad/s].
        stamp : (S,)
            [s].
        roll, pitch : float
            At the first sample [rad].
        """
        pitches = pitch + _integral(rates[:, 1], stamp)
        along = np.clip(pitches, -_STEEPEST, _STEEPEST)
        return cls(roll + _integral(rates[:, 0] / np.cos(along), stamp), pitches)

    def require_level(self, stamp: Array) -> None:
        """Raise DataError where the body pitches by more than some 70 deg: no rates about level axes."""
        steep = np.flatnonzero(np.abs(self.pitch) > _STEEPEST)
        if len(steep):
            at = steep[0]
            raise DataError(
                "navigation_frame_rates: expected rates about level axes, by which a body pitches by less "
                f"than {np.degrees(_STEEPEST):.0f} deg, got {np.degrees(self.pitch[at]):.0f} deg after "
                f"{stamp[at] - stamp[0]:.1f} s; switch data.repair.navigation_frame_rates off"
            )

    def in_body(self, rates: Array) -> Array:
        """Rates ``(S, 3)`` about the body's axes of those about level ones [rad/s]."""
        level_R_body = Rotation.from_euler("YX", np.column_stack([self.pitch, self.roll])).as_matrix()
        return np.asarray(np.einsum("sij,si->sj", level_R_body, rates))


def _integral(values: Array, stamp: Array) -> Array:
    """Integral ``(S,)`` up to each stamp, by trapezia."""
    area = 0.5 * (values[1:] + values[:-1]) * np.diff(stamp)
    return np.concatenate([np.zeros(1), np.cumsum(area)])
