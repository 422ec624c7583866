"""Width and height of an image file by its head, without decoding it."""

import struct

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"
_START_OF_FRAME = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
"""Markers of a JPEG behind which its size stands (ITU-T T.81, table B.1)."""


def image_size(content: bytes) -> tuple[int, int] | None:
    """Width and height of a PNG or JPEG [px]; None if it is neither, or cut short."""
    try:
        if content.startswith(_PNG):
            width, height = struct.unpack_from(">II", content, 16)
            return int(width), int(height)
        return _jpeg(content) if content.startswith(_JPEG) else None
    except struct.error:
        return None


def _jpeg(content: bytes) -> tuple[int, int] | None:
    at = 2
    while at < len(content):
        marker, length = struct.unpack_from(">HH", content, at)
        if marker >> 8 != 0xFF:
            return None
        if marker & 0xFF in _START_OF_FRAME:
            height, width = struct.unpack_from(">HH", content, at + 5)
            return int(width), int(height)
        at += 2 + length
    return None
