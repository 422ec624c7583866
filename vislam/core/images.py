"""A stereo recording as images: files, stamps and cameras of each pair; no pixel is held."""

from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np

from vislam.base.types import Array
from vislam.models.stereo_pair import StereoPair


@dataclass(frozen=True)
class Inertia:
    """Inertial samples that came with the images. Arrays are read-only.

    Attributes
    ----------
    stamp : (S,)
        In the clock of the images, increasing [s].
    gyro : (S, 3)
        Angular velocity, body frame [rad/s].
    velocity : (S, 3) or None
        Velocity as an inertial system gives it, body frame [m/s].
    accelerometer : (S, 3) or None
        Specific force, body frame [m/s^2].
    """

    stamp: Array
    gyro: Array
    velocity: Array | None = None
    accelerometer: Array | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False


@dataclass(frozen=True)
class StampedPoses:
    """Poses of the body by another instrument.

    Attributes
    ----------
    stamp : (m,)
        In the clock of the images, increasing [s].
    world_T_imu : (m, 4, 4)
        In a world with z up.
    origin : str
        What they were made from, and how.
    """

    stamp: Array
    world_T_imu: Array
    origin: str


@dataclass(frozen=True)
class ReferenceFile:
    """A reference trajectory beside the images, and its format by the name that a config has for it."""

    path: Path
    format: str


@dataclass(frozen=True)
class ImageRecording:
    """Pairs of images in the order of time.

    Attributes
    ----------
    name : str
    stamp : (T,)
        Of the left images, increasing [s].
    left, right : tuple of Path
        One file a pair.
    pair : StereoPair
        Cameras, and the rectified pair.
    inertia : Inertia or None
    reference : StampedPoses, ReferenceFile or None
    levelled : bool
        Whether the velocity is parallel to the earth's surface, with the climb rate for its third component.
    counts : dict
        What was listed, and left out before any image was read.
    """

    name: str
    stamp: Array
    left: tuple[Path, ...]
    right: tuple[Path, ...]
    pair: StereoPair
    inertia: Inertia | None = None
    reference: StampedPoses | ReferenceFile | None = None
    levelled: bool = False
    counts: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.stamp)
