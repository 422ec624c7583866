"""Stereo images and inertial samples of a ROS bag, streamed: a bag is never in memory."""

from bisect import bisect_left, insort
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.images import Content, ImageRecording, Inertia, RawImage
from vislam.datasets.asl import cameras_of, mav0_of
from vislam.datasets.bag_calibration import calibration_of
from vislam.datasets.bag_topics import COMPRESSED, Choice, StereoTopics, choose_topics
from vislam.datasets.bags import Bag, opened_bag
from vislam.datasets.calibration_yaml import Camchain, read_camchain
from vislam.datasets.image_lists import NANOSECONDS, Listed, paired
from vislam.datasets.inertial_table import inertia_of

_LATEST = 32
"""Images with later stamps that may have arrived before one: as many are held in memory."""


@dataclass(frozen=True)
class BagImages:
    """Images of one topic of a bag.

    Attributes
    ----------
    path : Path
    topic : str
    number : (n,)
        Which message of the topic each is, in the order of arrival, from 0.
    """

    path: Path
    topic: str
    number: IntArray

    @property
    def place(self) -> str:
        """The bag and the topic."""
        return f"{self.path}: {self.topic}"

    def __len__(self) -> int:
        """Return the number of images."""
        return len(self.number)

    def of(self, rows: "IntArray | BoolArray") -> "BagImages":
        """The images of a mask or of indices."""
        return BagImages(self.path, self.topic, self.number[rows])

    def present(self) -> BoolArray:
        """All: what is listed was there."""
        return np.ones(len(self), bool)

    def __iter__(self) -> Iterator[Content | None]:
        """Read one after the other; those that arrived too early are held until their turn comes."""
        order, held, done = self.number.tolist(), dict[int, Content | None](), 0
        wanted = set(order)
        with opened_bag(self.path) as bag:
            packed = bag.topics[self.topic].kind == COMPRESSED
            for number, (_, _, raw) in enumerate(bag.messages({self.topic})):
                if number in wanted:
                    held[number] = self._content(bag, raw, packed=packed)
                while done < len(order) and order[done] in held:
                    yield held.pop(order[done])
                    done += 1
                if done == len(order):
                    return
        # The bag has become shorter since it was listed.
        yield from [None] * (len(order) - done)

    def _content(self, bag: Bag, raw: bytes, *, packed: bool) -> Content | None:
        try:
            message = bag.message(self.topic, raw)
        except DataError:
            return None
        if packed:
            return bytes(message.data)
        pixels = np.asarray(message.data).view(np.uint8)
        return RawImage(
            str(message.encoding),
            int(message.height),
            int(message.width),
            int(message.step),
            pixels,
            bool(message.is_bigendian),
        )


@dataclass
class _Stamps:
    """Stamps [ns] of the messages of a topic, in the order of arrival, and the number of each."""

    of_header: list[int] = field(default_factory=list)
    of_arrival: list[int] = field(default_factory=list)
    number: list[int] = field(default_factory=list)

    def used(self) -> tuple[IntArray, int]:
        """Those of the headers, or of the arrivals where all headers have 0; how many of the latter."""
        if self.of_header and not any(self.of_header):
            return np.array(self.of_arrival, dtype=np.int64), len(self.of_arrival)
        return np.array(self.of_header, dtype=np.int64), 0


def load_bag(path: Path, choice: Choice) -> ImageRecording:
    """List the images of a bag and read its inertial samples; no image is decoded.

    Parameters
    ----------
    path : Path
        A file ``.bag``, ``.mcap`` or ``.db3``, or the folder of a bag of ROS 2.
    choice : Choice
        Topics and calibration, where they are not to be guessed.

    Raises
    ------
    DataError
        If the bag cannot be read, it is not clear what is meant, the calibration is missing or cannot be
        right, or no pair is left.
    """
    file = calibration_file(path, choice)
    chain = None if file is None else _read_calibration(file)
    with opened_bag(path) as bag:
        topics = choose_topics(bag, choice, calibrated=None if chain is None else chain.topics)
        if chain is not None and chain.topics == (topics.right, topics.left):
            chain = chain.swapped()
        pair, mounted = (
            calibration_of(bag, topics) if chain is None or file is None else (chain.rectified(file), True)
        )
        cameras, rows, counts = _scanned(bag, topics)
    listed = [_listed(path, topic, cameras[topic], counts) for topic in (topics.left, topics.right)]
    left, right, more = paired(listed[0], listed[1], where=path)
    inertia, dropped = _inertia(rows, chain, path=path, topics=topics, mounted=mounted)
    return ImageRecording(
        name=path.absolute().stem,
        stamp=np.asarray(left.stamp_ns * NANOSECONDS, dtype=np.float64),
        left=left.images,
        right=right.images,
        pair=pair,
        inertia=inertia,
        counts={**more, **counts, **dropped},
    )


def calibration_file(path: Path, choice: Choice) -> Path | None:
    """The ``camchain`` file that was named, or the only one beside or in the bag; None if there is none.

    Raises
    ------
    DataError
        If there are more.
    """
    if choice.calibration is not None:
        return choice.calibration
    folders = [path, path.absolute().parent] if path.is_dir() else [path.absolute().parent]
    found = [file for folder in folders for file in sorted(folder.glob("*camchain*.yaml"))]
    if len(found) > 1:
        told = ", ".join(file.name for file in found)
        raise DataError(
            f"{path}: more than one calibration lies beside it: {told}; choose with --calibration"
        )
    return found[0] if found else None


def _read_calibration(path: Path) -> Camchain:
    """A ``camchain`` file, or the ``sensor.yaml`` of both cameras of a folder, as EuRoC has them."""
    return cameras_of(mav0_of(path)) if path.is_dir() else read_camchain(path)


def _scanned(bag: Bag, topics: StereoTopics) -> tuple[dict[str, _Stamps], Array, Counter[str]]:
    """Stamps of both cameras, inertial samples ``(S, 7)``, and counts, in one pass over the bag."""
    cameras = {topics.left: _Stamps(), topics.right: _Stamps()}
    seen: Counter[str] = Counter()
    counts: Counter[str] = Counter(images_without_stamp=0)
    rows: list[list[float]] = []
    wanted = {topics.left, topics.right} | ({topics.imu} if topics.imu is not None else set())
    for topic, arrived, raw in bag.messages(wanted):
        if topic == topics.imu:
            row = _sample(bag, topic, arrived, raw)
            if row is None:
                counts["inertial_corrupt"] += 1
            else:
                rows.append(row)
            continue
        stamp, number = bag.stamp_ns(raw), seen[topic]
        seen[topic] += 1
        if stamp is None:
            counts["images_without_stamp"] += 1
            continue
        cameras[topic].of_header.append(stamp)
        cameras[topic].of_arrival.append(arrived)
        cameras[topic].number.append(number)
    return cameras, np.array(rows).reshape(-1, 7), counts


def _sample(bag: Bag, topic: str, arrived: int, raw: bytes) -> list[float] | None:
    """Stamp [ns], angular velocity and specific force; None if they are no finite numbers."""
    try:
        message = bag.message(topic, raw)
    except DataError:
        return None
    gyro, accelerometer = message.angular_velocity, message.linear_acceleration
    stamp = bag.stamp_ns(raw) or arrived
    row = [float(stamp), *(_axes(gyro)), *(_axes(accelerometer))]
    return row if bool(np.isfinite(row).all()) else None


def _axes(vector: Any) -> tuple[float, float, float]:
    return float(vector.x), float(vector.y), float(vector.z)


def _listed(path: Path, topic: str, stamps: _Stamps, counts: Counter[str]) -> Listed:
    """Images of a topic in the order of arrival, without those that arrived too late to be waited for."""
    stamp, of_arrival = stamps.used()
    in_time = ~_late(stamp)
    counts["images_stamped_by_arrival"] += of_arrival
    counts["images_late"] += int(np.sum(~in_time))
    number = np.array(stamps.number, dtype=np.int64)
    return Listed(stamp[in_time], BagImages(path, topic, number[in_time]))


def _late(stamp: IntArray) -> BoolArray:
    """Mask ``(n,)`` of images before which too many with later stamps have arrived.

    One out of order by a few is put in its place; to wait for one that is off by minutes would fill the
    memory.
    """
    late = np.zeros(len(stamp), bool)
    later: list[int] = []
    for place in np.argsort(stamp, kind="stable")[::-1].tolist():
        before = bisect_left(later, place)
        late[place] = before > _LATEST
        if not late[place]:
            insort(later, place)
    return late


def _inertia(
    rows: Array, chain: Camchain | None, *, path: Path, topics: StereoTopics, mounted: bool
) -> tuple[Inertia | None, dict[str, int]]:
    if topics.imu is None:
        return None, {}
    if not mounted:
        return None, {"inertial_samples_without_mounting": len(rows)}
    return inertia_of(rows, chain, where=Path(f"{path}: {topics.imu}"))
