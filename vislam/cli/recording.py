"""Options that say what is meant in a recording of images, and lines on what is in one."""

import argparse
import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from vislam.base.errors import DataError
from vislam.datasets.bag_topics import NONE, Choice
from vislam.datasets.bags import is_bag, opened_bag

if TYPE_CHECKING:
    from vislam.core.images import ImageRecording


def add_choice_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name topics and calibration of a bag."""
    add = parser.add_argument
    add(
        "--left",
        metavar="TOPIC",
        help="images of the left camera in a bag (default: guessed, as all of these)",
    )
    add("--right", metavar="TOPIC", help="images of the right camera in a bag")
    add("--imu", metavar="TOPIC", help=f"inertial samples in a bag; {NONE}: do without")
    add(
        "--calibration",
        type=Path,
        metavar="PATH",
        help="camchain file of Kalibr, or folder with cam0/sensor.yaml and cam1/sensor.yaml (EuRoC), in "
        "place of one beside a bag or of its CameraInfo",
    )


def add_front_end_option(parser: argparse.ArgumentParser) -> None:
    """Add the option that names the front end."""
    parser.add_argument(
        "--front-end",
        default="klt",
        metavar="NAME",
        help="what makes the tracks: one that is installed, or my_module:build (default: klt)",
    )


def choice_of(options: argparse.Namespace) -> Choice:
    """What the options say."""
    return Choice(options.left, options.right, options.imu, options.calibration)


def located(path: Path) -> Path:
    """The path, or, where it is only the name of a recording, where ``vislam fetch`` has put that."""
    if os.path.exists(path):
        return path
    from vislam.datasets.archives import image_set  # noqa: PLC0415
    from vislam.datasets.find import find_path, search_path  # noqa: PLC0415

    known = image_set(str(path))
    if known is None:
        return path
    found = find_path(known.folder, search_path(None))
    if found is None:
        raise DataError(f"{path}: not here; vislam fetch {path} brings it into the user cache")
    return found


def listed(path: Path, choice: Choice) -> Iterator[str]:
    """Lines on a recording of images: the topics of a bag, and what is taken of it.

    Raises
    ------
    DataError
        If it cannot be used, after the lines that were possible.
    """
    from vislam.datasets.images import open_images  # noqa: PLC0415

    topics = _topics(path) if is_bag(path) else {}
    yield from topics.values()
    recording = open_images(path, choice)
    yield from taken(recording)
    yield f"vislam compare --data {path} makes tracks, inspects them and compares estimators on them"


def _topics(path: Path) -> dict[str, str]:
    with opened_bag(path) as bag:
        width = max((len(name) for name in bag.topics), default=0)
        return {one.name: f"{one.name:{width}}  {one.count:7d}  {one.kind}" for one in bag.topics.values()}


def taken(recording: "ImageRecording") -> Iterator[str]:
    """Lines on what is used of a recording."""
    import numpy as np  # noqa: PLC0415

    pair, stamp = recording.pair, recording.stamp
    period = float(np.median(np.diff(stamp)))
    yield (
        f"{recording.name}: {len(recording)} pairs in {stamp[-1] - stamp[0]:.1f} s ({1.0 / period:.1f} Hz), "
        f"{pair.left.width} x {pair.left.height} px, {pair.left.lens.value} lenses, "
        f"baseline {pair.rig.baseline:.4f} m"
    )
    yield f"left: {recording.left.place}; right: {recording.right.place}"
    inertia = recording.inertia
    if inertia is not None:
        rate = 1.0 / float(np.median(np.diff(inertia.stamp)))
        with_velocity = "with" if inertia.velocity is not None else "without"
        yield f"inertial samples: {len(inertia.stamp)} ({rate:.0f} Hz), {with_velocity} velocity"
    else:
        yield f"inertial samples: none{_without_mounting(recording)}"
    counted = [f"{name.replace('_', ' ')} {count}" for name, count in recording.counts.items() if count]
    yield f"counted: {', '.join(counted)}"


def _without_mounting(recording: "ImageRecording") -> str:
    left_out = recording.counts.get("inertial_samples_without_mounting")
    if not left_out:
        return ""
    return (
        f"; {left_out} are left out, as nothing says how the sensor sits on the cameras (T_cam_imu of a "
        "camchain file, or /tf_static)"
    )
