"""Images read one pair at a time; what is broken is counted by its kind and left out."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

import cv2
import numpy as np

from vislam.base.errors import DataError
from vislam.core.images import Content, ImageRecording
from vislam.frontend.decoding import ENCODINGS, BrokenImageError, Picture, decoded
from vislam.models.camera import Camera

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
        self.counts: Counter[str] = Counter(
            images_corrupt=0, images_truncated=0, images_of_wrong_size=0, images_of_unknown_encoding=0
        )

    def __iter__(self) -> Iterator[PicturePair]:
        """Give each pair that can be read; two are held at most."""
        pair = self._recording.pair
        contents = zip(self._recording.left, self._recording.right, strict=True)
        for index, (left_content, right_content) in enumerate(contents):
            try:
                left = self._picture(left_content, pair.left)
                right = self._picture(right_content, pair.right)
            except BrokenImageError as error:
                self.counts[str(error)] += 1
            else:
                yield PicturePair(index, left, right)
        self._refuse_if_all("images_of_wrong_size", _wrong_size(pair.left))
        self._refuse_if_all("images_of_unknown_encoding", f"must have pixels as {', '.join(ENCODINGS)}")

    def _refuse_if_all(self, count: str, wanted: str) -> None:
        if self.counts[count] >= len(self._recording):
            raise DataError(f"{self._recording.left.place}: {wanted}, got another in every pair")

    def _picture(self, content: Content | None, camera: Camera) -> Picture:
        picture = decoded(content)
        if picture.shape != (camera.height, camera.width):
            raise BrokenImageError("images_of_wrong_size")
        return picture if self._clahe is None else np.asarray(self._clahe.apply(picture), dtype=np.uint8)


def _wrong_size(camera: Camera) -> str:
    return (
        f"must have images of {camera.width} x {camera.height} px as its calibration says (is that of "
        "these images?)"
    )
