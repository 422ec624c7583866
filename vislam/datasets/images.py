"""A recording of stereo images in whichever layout it is."""

from pathlib import Path

from vislam.base.errors import DataError
from vislam.core.images import ImageRecording
from vislam.datasets.asl import is_asl, load_asl
from vislam.datasets.bag_images import load_bag
from vislam.datasets.bag_topics import Choice
from vislam.datasets.bags import is_bag
from vislam.datasets.kitti_raw import drive_in, load_kitti_raw

_ASK = Choice()


def is_images(path: Path) -> bool:
    """Whether a path is a recording of images in a layout that is known."""
    return is_bag(path) or (path.is_dir() and (is_asl(path) or drive_in(path) is not None))


def open_images(path: Path, choice: Choice = _ASK) -> ImageRecording:
    """List the images of a folder or a bag; none is decoded.

    Parameters
    ----------
    path : Path
        Folder, or bag.
    choice : Choice
        Topics and calibration of a bag, where they are not to be guessed.

    Raises
    ------
    DataError
        If it is not there, in no layout that is known, or what belongs to the layout is missing or wrong.
    """
    if is_bag(path):
        return load_bag(path, choice)
    if choice != _ASK:
        raise DataError(f"{path}: --left, --right, --imu and --calibration are of bags, and this is none")
    if not path.is_dir():
        raise DataError(
            f"{path}: no such folder; name the one that holds mav0, a KITTI raw drive, or a bag (.bag, "
            ".mcap, .db3)"
        )
    if is_asl(path):
        return load_asl(path)
    if drive_in(path) is not None:
        return load_kitti_raw(path)
    raise DataError(
        f"{path}: must hold mav0 with cam0 and cam1 (EuRoC, TUM-VI), be a KITTI raw drive with image_00 and "
        "image_01 (the only one below it), or a bag, got none of these"
    )
