"""Repairs of the rig: how the extrinsic is read, in which body axes, and the baseline."""

from dataclasses import replace
from typing import Literal

import numpy as np
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT, Positive
from vislam.core.sequence import Sequence
from vislam.geometry import se3
from vislam.geometry.axes import axes_rotation

Reading = Literal["stored", "inverse"]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Extrinsic:
    """Read the stored extrinsic the other way round than its key says, whole or in part.

    A file can hold the rotation of one direction with the translation of the other.
    """

    rotation: Reading = "inverse"
    """``inverse``: the rotation is that of the inverse of what the key says."""
    translation: Reading = "inverse"
    """``inverse``: the translation is that of the inverse of what the key says."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Read it so."""
        stored = sequence.rig.imu_T_cam
        inverse = se3.inverse(stored)
        rotation = stored if self.rotation == "stored" else inverse
        translation = stored if self.translation == "stored" else inverse
        read = se3.from_rotation_translation(rotation[:3, :3], translation[:3, 3])
        return replace(sequence, rig=replace(sequence.rig, imu_T_cam=read))


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Axes:
    """Turn the extrinsic into the body axes of the velocities."""

    body: tuple[str, str, str]
    """The velocities' body axes in those of the extrinsic: ``[x, -y, -z]`` says that the velocities are
    forward-left-up where the extrinsic is forward-right-down."""

    def __post_init__(self) -> None:
        """Reject axes that form no proper turn."""
        axes_rotation(self.body)

    def apply(self, sequence: Sequence) -> Sequence:
        """Turn it."""
        turn = se3.from_rotation_translation(axes_rotation(self.body), np.zeros(3))
        return replace(sequence, rig=replace(sequence.rig, imu_T_cam=turn @ sequence.rig.imu_T_cam))


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Baseline:
    """Replace the stereo baseline."""

    metres: Positive
    """Distance between the cameras [m]."""

    def apply(self, sequence: Sequence) -> Sequence:
        """Replace it."""
        return replace(sequence, rig=replace(sequence.rig, baseline=self.metres))
