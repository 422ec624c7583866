"""A stereo recording as images: stamps, cameras, and where the images of each pair are; no pixel is held."""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.imu import ImuSeries
from vislam.models.imu import ImuNoise
from vislam.models.stereo_pair import StereoPair


@dataclass(frozen=True)
class RawImage:
    """An image as a message carries it, without compression.

    Attributes
    ----------
    encoding : str
        How its pixels are laid out, by the names of ``sensor_msgs/image_encodings``: ``mono8``, ``bgr8`` ...
    height, width : int
        [px].
    step : int
        Bytes of a row.
    data : (height * step,)
        Bytes.
    big_endian : bool
        Of pixels with more than eight bits a channel.
    """

    encoding: str
    height: int
    width: int
    step: int
    data: NDArray[np.uint8]
    big_endian: bool = False


_FEWEST = 2
"""Samples of a series."""
Content = bytes | RawImage
"""What is stored of an image: the bytes of an image file, or pixels."""


class Images(Protocol):
    """Images of one camera, in the order of their stamps; one is in memory at a time."""

    @property
    def place(self) -> str:
        """Where they are, for messages."""

    def __len__(self) -> int:
        """Return the number of images."""

    def __iter__(self) -> Iterator[Content | None]:
        """Read one after the other; None is one that cannot be read."""

    def of(self, rows: "IntArray | BoolArray") -> "Images":
        """The images of a mask or of indices."""

    def present(self) -> BoolArray:
        """Mask ``(n,)`` of those that are there."""


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
    noise : ImuNoise or None
        As the recording's own files state it, which is mostly a data sheet.
    """

    stamp: Array
    gyro: Array
    velocity: Array | None = None
    accelerometer: Array | None = None
    noise: ImuNoise | None = None

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    @property
    def series(self) -> ImuSeries | None:
        """Samples of gyro and accelerometer; None without the latter, or with a single sample."""
        if self.accelerometer is None or len(self.stamp) < _FEWEST:
            return None
        return ImuSeries.of(self.stamp, self.gyro, self.accelerometer)


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
    name : str
        Of the reference, for the report.
    """

    stamp: Array
    world_T_imu: Array
    origin: str
    name: str


@dataclass(frozen=True)
class ReferenceFile:
    """A reference trajectory beside the images, and its format by the name that a config has for it.

    Attributes
    ----------
    path : Path
    format : str
    sigma_m : float
        Standard deviation of its positions, where those who recorded it say it [m]; 0 where nobody does.
    limits : str
        What a reader of the report must know of it.
    """

    path: Path
    format: str
    sigma_m: float = 0.0
    limits: str = "as it lay beside the images"


@dataclass(frozen=True)
class ImageRecording:
    """Pairs of images in the order of time.

    Attributes
    ----------
    name : str
    stamp : (T,)
        Of the left images, increasing [s].
    left, right : Images
        One image a pair.
    pair : StereoPair
        Cameras, and the rectified pair.
    inertia : Inertia or None
    reference : StampedPoses, ReferenceFile or None
    levelled : bool
        Whether the velocity is parallel to the earth's surface, with the vertical velocity for its third
        component.
    counts : dict
        What was listed, and left out before any image was read.
    """

    name: str
    stamp: Array
    left: Images
    right: Images
    pair: StereoPair
    inertia: Inertia | None = None
    reference: StampedPoses | ReferenceFile | None = None
    levelled: bool = False
    counts: dict[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.stamp)
