"""Images off the disk, one pair at a time; what is broken is counted by its kind and left out."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from vislam.base.errors import DataError
from vislam.core.images import ImageRecording
from vislam.models.camera import Camera

Picture = NDArray[np.uint8]
"""Grey image, ``(height, width)``."""

_ENDS = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND\xaeB`\x82"}
"""How a JPEG and a PNG begin, and how a whole one ends."""
_TAIL = 64
"""Bytes at the end in which the end may be: some programs write padding after it."""
_CLIP, _TILES = 2.0, (8, 8)


@dataclass(frozen=True)
class PicturePair:
    """Both images of a frame, and the index of the pair in its recording."""

    index: int
    left: Picture
    right: Picture


class Pictures:
    """Reads the pairs of a recording in order, and counts what it cannot read.

    Attributes
    ----------
    counts : Counter
        Pairs left out, by reason.
    """

    def __init__(self, recording: ImageRecording, *, equalise: bool) -> None:
        self._recording = recording
        self._clahe = cv2.createCLAHE(_CLIP, _TILES) if equalise else None
        self.counts: Counter[str] = Counter(images_corrupt=0, images_truncated=0, images_of_wrong_size=0)

    def __iter__(self) -> Iterator[PicturePair]:
        """Give each pair that can be read; two are held at most."""
        pair = self._recording.pair
        paths = zip(self._recording.left, self._recording.right, strict=True)
        for index, (left_path, right_path) in enumerate(paths):
            left = self._read(left_path, pair.left)
            right = None if left is None else self._read(right_path, pair.right)
            if left is not None and right is not None:
                yield PicturePair(index, left, right)
        if self.counts["images_of_wrong_size"] >= len(self._recording):
            first = self._recording.left[0]
            raise DataError(
                f"{first.parent}: must have images of {pair.left.width} x {pair.left.height} px as its "
                "calibration "
                "says, got another size in every pair; is the calibration of these images?"
            )

    def _read(self, path: Path, camera: Camera) -> Picture | None:
        """Grey image, or None if it is broken."""
        try:
            content = path.read_bytes()
        except OSError:
            self.counts["images_corrupt"] += 1
            return None
        end = _ENDS.get(content[:2])
        if end is not None and end not in content[-_TAIL:]:
            self.counts["images_truncated"] += 1
            return None
        picture = _decoded(content)
        if picture is None:
            self.counts["images_corrupt"] += 1
            return None
        if picture.shape != (camera.height, camera.width):
            self.counts["images_of_wrong_size"] += 1
            return None
        return picture if self._clahe is None else np.asarray(self._clahe.apply(picture), dtype=np.uint8)


def _decoded(content: bytes) -> Picture | None:
    """Grey image of eight bits; 16 bits, as in TUM-VI, are scaled down."""
    if not content:
        return None
    try:
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE)
    except cv2.error:
        return None
    return None if picture is None else np.asarray(picture, dtype=np.uint8)
