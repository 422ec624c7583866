"""Which topics of a bag are the stereo pair and the inertial sensor: as named, or guessed from the names."""

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from vislam.base.errors import DataError
from vislam.base.legible import one_line
from vislam.datasets.bags import Bag

IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
IMU = "sensor_msgs/msg/Imu"
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
NONE = "none"
_NOT_GREY = re.compile("depth|disparity|mask|confidence", re.IGNORECASE)
_SIDE = re.compile(r"left|(?<![a-z])l(?![a-z])|\d+", re.IGNORECASE)
_RIGHT = {"left": "right", "Left": "Right", "LEFT": "RIGHT", "l": "r", "L": "R"}
_LONGEST_LIST = 400


@dataclass(frozen=True)
class Choice:
    """What the user said of a recording; None where it is to be guessed.

    Attributes
    ----------
    left, right : str or None
        Topics of the images of a bag.
    imu : str or None
        Topic of the inertial sensor of a bag; "none" for none.
    calibration : Path or None
        A Kalibr ``camchain`` file, or a folder with ``cam0/sensor.yaml`` and ``cam1/sensor.yaml``.
    """

    left: str | None = None
    right: str | None = None
    imu: str | None = None
    calibration: Path | None = None


@dataclass(frozen=True)
class StereoTopics:
    """Topics of a stereo pair, and of an inertial sensor if there is one."""

    left: str
    right: str
    imu: str | None


def choose_topics(bag: Bag, choice: Choice, *, calibrated: tuple[str, str] | None) -> StereoTopics:
    """Topics as the user named them, as the calibration has them, or as their names have it.

    Parameters
    ----------
    bag : Bag
    choice : Choice
    calibrated : tuple of str or None
        Topics of the two cameras of a ``camchain`` file.

    Raises
    ------
    DataError
        If a topic that was named is not there, or it is not clear which are meant; it lists what there is.
    """
    images = image_topics(bag)
    for name in (choice.left, choice.right):
        if name is not None and name not in images:
            raise DataError(f"{bag.path}: must have images on the topic {name}, got {_listed(images)}")
    left, right = choice.left, choice.right
    if left is None or right is None:
        left, right = _guessed(bag.path, images, choice, calibrated)
    if left == right:
        raise DataError(f"{bag.path}: --left and --right must be two topics, got {left} for both")
    return StereoTopics(left, right, _imu(bag, choice))


def image_topics(bag: Bag) -> list[str]:
    """Topics of images, each camera once: compressed ones only where there are no others."""
    plain = [topic.name for topic in bag.topics.values() if topic.kind == IMAGE and topic.count]
    packed = [
        topic.name
        for topic in bag.topics.values()
        if topic.kind == COMPRESSED and topic.count and topic.name.rpartition("/")[0] not in plain
    ]
    return sorted(name for name in plain + packed if not _NOT_GREY.search(name))


def pairs_by_name(names: Iterable[str]) -> list[tuple[str, str]]:
    """Pairs of names that differ in their side alone: left and right, l and r, a number and the next."""
    known, found = sorted(names), []
    for name in known:
        for match in _SIDE.finditer(name):
            side = match.group()
            other = str(int(side) + 1).zfill(len(side)) if side.isdigit() else _RIGHT.get(side, "right")
            partner = name[: match.start()] + other + name[match.end() :]
            if partner in known:
                found.append((name, partner))
    return found


def _guessed(
    path: Path, images: list[str], choice: Choice, calibrated: tuple[str, str] | None
) -> tuple[str, str]:
    pairs = pairs_by_name(images)
    if calibrated is not None and all(name in images for name in calibrated):
        pairs = [calibrated]
    elif not pairs and len(images) == 2:
        pairs = [(images[0], images[1])]
    pairs = [
        (left, right)
        for left, right in pairs
        if choice.left in (None, left) and choice.right in (None, right)
    ]
    if len(pairs) == 1:
        return pairs[0]
    if pairs:
        told = one_line(", ".join(f"{left} and {right}" for left, right in pairs), limit=_LONGEST_LIST)
        raise DataError(
            f"{path}: more than one pair of images may be meant: {told}; choose with --left TOPIC and "
            "--right TOPIC"
        )
    raise DataError(
        f"{path}: must have images of a left and a right camera, got {_listed(images)}; name them with "
        "--left TOPIC and --right TOPIC"
    )


def _imu(bag: Bag, choice: Choice) -> str | None:
    known = [topic.name for topic in bag.topics.values() if topic.kind == IMU and topic.count]
    if choice.imu == NONE:
        return None
    if choice.imu is not None:
        if choice.imu not in known:
            raise DataError(f"{bag.path}: must have {IMU} on the topic {choice.imu}, got {_listed(known)}")
        return choice.imu
    if len(known) > 1:
        raise DataError(
            f"{bag.path}: more than one inertial sensor may be meant: {_listed(known)}; choose with "
            f"--imu TOPIC, or --imu {NONE}"
        )
    return known[0] if known else None


def _listed(names: list[str]) -> str:
    return one_line(", ".join(names), limit=_LONGEST_LIST) if names else "none"
