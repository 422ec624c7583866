"""What a front end is, and what it may return: any that follows this can take the place of ours."""

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from vislam.base.errors import ContractError
from vislam.core.images import ImageRecording
from vislam.frontend.decoding import Picture
from vislam.frontend.tracks import Tracks


class FrontEnd(Protocol):
    """What is built from a recording and options, and fed its pairs of images in order.

    It may have an attribute ``counts``, a mapping of names to whole numbers, that goes into the summary.
    """

    def process(self, left: Picture, right: Picture, *, stamp: float) -> Tracks | None:
        """Return the tracks in view in a pair of images; None to leave the pair out.

        Parameters
        ----------
        left, right : (height, width) uint8
            As the cameras gave them, not rectified.
        stamp : float
            Increasing [s].
        """


Build = Callable[[ImageRecording, Any], FrontEnd]
"""Makes a front end of a recording, of which it must not read the images, and of its options."""


def checked(tracks: object, *, index: int) -> Tracks:
    """The tracks of a pair, if they are as they must be.

    Raises
    ------
    ContractError
        If they are not; the message names the pair and the field.
    """
    if not isinstance(tracks, Tracks):
        raise ContractError(f"pair {index}: process must return Tracks or None, got {type(tracks).__name__}")
    count = len(tracks.track)
    if tracks.track.shape != (count,) or not np.issubdtype(tracks.track.dtype, np.integer):
        raise ContractError(f"pair {index}: track must be whole numbers (n,), got {tracks.track.dtype}")
    if count and (tracks.track.min() < 0 or len(np.unique(tracks.track)) < count):
        raise ContractError(f"pair {index}: track must be ids >= 0, each once")
    for name, columns in (("left", 2), ("right", 2), ("pixels", 4), ("distance", 2)):
        values = getattr(tracks, name)
        if values.shape != (count, columns):
            raise ContractError(f"pair {index}: {name} must be ({count}, {columns}), got {values.shape}")
        if not np.isfinite(values).all():
            raise ContractError(f"pair {index}: {name} must be finite numbers, got others")
    return tracks


def counts_of(front_end: FrontEnd) -> dict[str, int]:
    """What a front end counted; nothing if it does not count."""
    counts = getattr(front_end, "counts", {})
    return {str(name): int(count) for name, count in counts.items()} if isinstance(counts, Mapping) else {}
