"""Grey images of eight bits out of image files and out of pixels as messages carry them."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from vislam.core.images import Content, RawImage

Picture = NDArray[np.uint8]
"""Grey image, ``(height, width)``."""

_ENDS = {b"\xff\xd8": b"\xff\xd9", b"\x89P": b"IEND\xaeB`\x82"}
"""How a JPEG and a PNG begin, and how a whole one ends."""
_TAIL = 64
"""Bytes at the end in which the end may be: some programs write padding after it."""
_CHANNELS = {
    "mono8": 1,
    "8UC1": 1,
    "bgr8": 3,
    "8UC3": 3,
    "rgb8": 3,
    "bgra8": 4,
    "8UC4": 4,
    "rgba8": 4,
    "bayer_rggb8": 1,
    "bayer_bggr8": 1,
    "bayer_gbrg8": 1,
    "bayer_grbg8": 1,
    "uyvy": 2,
    "yuv422": 2,
    "yuyv": 2,
    "yuv422_yuy2": 2,
}
_WIDE = {"mono16": 1, "16UC1": 1, "bayer_rggb16": 1, "bayer_bggr16": 1, "bayer_gbrg16": 1, "bayer_grbg16": 1}
_TO_GREY = {
    "bgr8": cv2.COLOR_BGR2GRAY,
    "8UC3": cv2.COLOR_BGR2GRAY,
    "rgb8": cv2.COLOR_RGB2GRAY,
    "bgra8": cv2.COLOR_BGRA2GRAY,
    "8UC4": cv2.COLOR_BGRA2GRAY,
    "rgba8": cv2.COLOR_RGBA2GRAY,
    # OpenCV names a Bayer pattern by its second row and column, ROS by the first.
    "bayer_rggb": cv2.COLOR_BayerBG2GRAY,
    "bayer_bggr": cv2.COLOR_BayerRG2GRAY,
    "bayer_gbrg": cv2.COLOR_BayerGR2GRAY,
    "bayer_grbg": cv2.COLOR_BayerGB2GRAY,
}
_LUMINANCE = {"uyvy": 1, "yuv422": 1, "yuyv": 0, "yuv422_yuy2": 0}
"""Channel of two that is the luminance."""

ENCODINGS = (*_CHANNELS, *_WIDE)
"""Layouts of pixels that can be read, by their names in ``sensor_msgs``."""


class BrokenImageError(ValueError):
    """An image that cannot be used; its text is the name of the count that it goes into."""


def decoded(content: Content | None) -> Picture:
    """Grey image of eight bits; 16 bits, as in TUM-VI, are scaled down.

    Raises
    ------
    BrokenImageError
        If it cannot be read, is cut short, or has pixels in a layout that is not known.
    """
    if isinstance(content, RawImage):
        return _of_pixels(content)
    if not content:
        raise BrokenImageError("images_corrupt")
    end = _ENDS.get(content[:2])
    if end is not None and end not in content[-_TAIL:]:
        raise BrokenImageError("images_truncated")
    picture = _tried(lambda: cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE))
    if picture is None:
        raise BrokenImageError("images_corrupt")
    return np.asarray(picture, dtype=np.uint8)


def _of_pixels(raw: RawImage) -> Picture:
    wide = raw.encoding in _WIDE
    channels = (_WIDE if wide else _CHANNELS).get(raw.encoding)
    if channels is None:
        raise BrokenImageError("images_of_unknown_encoding")
    width = raw.width * channels * (2 if wide else 1)
    if raw.height < 1 or raw.width < 1 or raw.step < width:
        raise BrokenImageError("images_corrupt")
    if raw.data.size < raw.height * raw.step:
        raise BrokenImageError("images_truncated")
    rows = raw.data[: raw.height * raw.step].reshape(raw.height, raw.step)[:, :width]
    if wide:
        # Of two bytes the more significant one: what scaling down leaves.
        rows = rows[:, 0 if raw.big_endian else 1 :: 2]
    if raw.encoding in _LUMINANCE:
        return np.ascontiguousarray(rows[:, _LUMINANCE[raw.encoding] :: 2])
    code = _TO_GREY.get(raw.encoding.removesuffix("16").removesuffix("8") if channels == 1 else raw.encoding)
    if code is None:
        return np.ascontiguousarray(rows)
    pixels = np.ascontiguousarray(rows).reshape(raw.height, raw.width, -1)
    picture = _tried(lambda: cv2.cvtColor(pixels, code))
    if picture is None:
        raise BrokenImageError("images_corrupt")
    return np.asarray(picture, dtype=np.uint8)


def _tried(work: Callable[[], object]) -> object | None:
    """What OpenCV gives; None if it raises an error."""
    try:
        return work()
    except cv2.error:
        return None
