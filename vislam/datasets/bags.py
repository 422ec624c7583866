"""ROS bags (ROS 1, ROS 2 in sqlite and MCAP), read message by message by the package rosbags."""

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from vislam.base.errors import DataError, first_line

_SUFFIXES = (".bag", ".db3", ".mcap")
_METADATA, _DESCRIBES, _HEAD = "metadata.yaml", b"rosbag2_bagfile_information", 4096
_LITTLE_ENDIAN = 1
_NANO = 1_000_000_000
_REMEDY = "recover it (rosbag reindex, ros2 bag reindex, mcap recover) or export it again"


@dataclass(frozen=True)
class Topic:
    """A topic of a bag: its name, the type of its messages as ROS 2 calls it, and how many there are."""

    name: str
    kind: str
    count: int


class Bag:
    """An open bag. What rosbags raises becomes one line that names the bag.

    Attributes
    ----------
    path : Path
        As the user named it.
    topics : dict
        By name.
    """

    def __init__(self, path: Path, reader: Any) -> None:
        self.path = path
        self._reader = reader
        counts: dict[str, Topic] = {}
        for connection in reader.connections:
            before = counts[connection.topic].count if connection.topic in counts else 0
            counts[connection.topic] = Topic(
                connection.topic, connection.msgtype, before + connection.msgcount
            )
        self.topics = dict(sorted(counts.items()))
        self._kinds = {topic.name: topic.kind for topic in counts.values()}

    def messages(self, topics: set[str]) -> Iterator[tuple[str, int, bytes]]:
        """Topic, stamp of arrival [ns] and bytes of each message, in the order of arrival."""
        chosen = [c for c in self._reader.connections if c.topic in topics]
        if not chosen:
            return
        stream, count = self._reader.messages(connections=chosen), 0
        while True:
            try:
                connection, arrived, raw = next(stream)
            except StopIteration:
                return
            except Exception as error:  # what the package raises depends on the kind of damage
                raise DataError(
                    f"{self.path}: cannot be read beyond message {count} ({first_line(error)}); {_REMEDY}"
                ) from None
            count += 1
            yield connection.topic, arrived, raw

    def message(self, topic: str, raw: bytes) -> Any:
        """The message with its fields; DataError if the bytes are no such message."""
        try:
            return self._reader.deserialize(raw, self._kinds[topic])
        except Exception as error:  # as above
            raise DataError(f"{self.path}: {topic} has a damaged message ({first_line(error)})") from None

    def stamp_ns(self, raw: bytes) -> int | None:
        """Stamp of a message that begins with a header [ns], without reading the rest; None if cut short."""
        try:
            if not self._reader.is2:
                seconds, nanoseconds = struct.unpack_from("<II", raw, 4)
            else:
                order = "<" if raw[1] & _LITTLE_ENDIAN else ">"
                seconds, nanoseconds = struct.unpack_from(f"{order}iI", raw, 4)
        except (struct.error, IndexError):
            return None
        return int(seconds) * _NANO + int(nanoseconds)


def is_bag(path: Path) -> bool:
    """Whether a path is named as a bag is, or is the folder of one."""
    if path.is_dir():
        return _is_described(path) or len(_files(path)) == 1
    return path.suffix in _SUFFIXES


def _is_described(folder: Path) -> bool:
    """Whether a folder has the description that ROS 2 writes into that of a bag."""
    try:
        with (folder / _METADATA).open("rb") as file:
            return _DESCRIBES in file.read(_HEAD)
    except OSError:
        return False


def _files(folder: Path) -> list[Path]:
    return [path for path in sorted(folder.iterdir()) if path.suffix in _SUFFIXES and path.is_file()]


@contextmanager
def opened_bag(path: Path) -> Iterator[Bag]:
    """Open a bag.

    Parameters
    ----------
    path : Path
        A file ``.bag``, ``.mcap`` or ``.db3``, or the folder of a bag of ROS 2.

    Raises
    ------
    DataError
        If rosbags is not installed, or it is no bag that can be read.
    """
    if find_spec("rosbags") is None:
        raise DataError(
            f"{path}: this is a rosbag; pip install 'vislam[ros]' to read it, or export it as text"
        )
    # It is an optional package.
    from rosbags.highlevel import AnyReader  # noqa: PLC0415
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415

    if not path.exists():
        raise DataError(f"{path}: no such file; name a bag (.bag, .mcap, .db3) or the folder of one")
    try:
        # Before 2023, bags in sqlite did not hold the definitions of their messages.
        store = get_typestore(Stores.ROS2_HUMBLE)
        reader = AnyReader([_place(path)], default_typestore=store)
        reader.open()
    except Exception as error:  # what the package raises depends on the kind of damage
        raise DataError(f"{path}: cannot be read as a rosbag ({first_line(error)}); {_REMEDY}") from None
    try:
        yield Bag(path, reader)
    finally:
        reader.close()


def _place(path: Path) -> Path:
    """What the package is to open: the folder of a file that has one, or the only file of a folder."""
    if path.is_dir():
        return path if _is_described(path) or not _files(path) else _files(path)[0]
    in_folder = path.suffix != ".bag" and _is_described(path.parent)
    return path.parent if in_folder else path
