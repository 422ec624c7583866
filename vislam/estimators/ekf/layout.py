"""Layout of the joint state: named blocks of the navigation state, then the landmarks."""

from collections.abc import Iterator, Mapping

import numpy as np

from vislam.base.types import Array
from vislam.geometry import so3
from vislam.models.imu import VELOCITY
from vislam.models.odometry import POSE

LANDMARK = 4
"""Size of a landmark: three coordinates, and its stereo-matching bias (``vislam.models.track_noise``)."""
COORDINATES = 3
"""Size in the error of the state where no track has a stereo-matching bias: that of its coordinates."""


class NavLayout:
    """Blocks of the navigation state, by name: the pose, and behind it those that a problem has in use.

    A block that is not in use is not there, and costs nothing.

    Parameters
    ----------
    blocks : mapping of str to int
        Name and size of each block behind the pose, in order.
    landmark : int
        Size of a landmark's error, ``LANDMARK`` or ``COORDINATES``.

    Attributes
    ----------
    size : int
        Size of the navigation state.
    landmark : int
    """

    def __init__(self, blocks: Mapping[str, int], *, landmark: int = LANDMARK) -> None:
        self.landmark = landmark
        self._blocks = {"pose": POSE}
        self.size = POSE.stop
        for name, size in blocks.items():
            self._blocks[name] = slice(self.size, self.size + size)
            self.size += size

    def __getitem__(self, name: str) -> slice:
        """Where a block stands."""
        return self._blocks[name]

    def __contains__(self, name: str) -> bool:
        """Whether a block is in use."""
        return name in self._blocks

    @property
    def moves(self) -> bool:
        """Whether a motion of the world changes a block behind the pose: the velocity, where it is in use."""
        return VELOCITY in self

    def moved(self, nav: Array) -> Array:
        """What a motion (omega, v) of the world does to the blocks behind the pose, ``(d - 6, 6)``.

        A turn takes the velocity along, ``omega x velocity``, a move leaves it.
        """
        out = np.zeros((self.size, 6))
        if VELOCITY in self:
            out[self[VELOCITY], :3] = -so3.hat(nav[self[VELOCITY]])
        return out[POSE.stop :]

    def __iter__(self) -> Iterator[str]:
        """Names of the blocks, in order."""
        return iter(self._blocks)
