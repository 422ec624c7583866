"""A recording of stereo images in whichever layout it is."""

from pathlib import Path

from vislam.base.errors import DataError
from vislam.core.images import ImageRecording
from vislam.datasets.asl import is_asl, load_asl
from vislam.datasets.bag_images import load_bag
from vislam.datasets.bag_topics import Choice
from vislam.datasets.bags import is_bag
from vislam.datasets.image_list_file import load_image_list
from vislam.datasets.kitti_odometry import is_kitti_odometry, load_kitti_odometry
from vislam.datasets.kitti_raw import drive_in, load_kitti_raw

_ASK = Choice()
_LISTS = (".yaml", ".yml")


def is_images(path: Path) -> bool:
    """Whether a path is a recording of images in a layout that is known."""
    return is_bag(path) or (_in_folder(path) if path.is_dir() else path.suffix in _LISTS)


def _in_folder(folder: Path) -> bool:
    """Whether a folder has images that are files; a bag may lie beside them."""
    return is_asl(folder) or is_kitti_odometry(folder) or drive_in(folder) is not None


def open_images(path: Path, choice: Choice = _ASK) -> ImageRecording:
    """List the images of a folder, a bag or a list; none is decoded.

    Parameters
    ----------
    path : Path
        Folder, bag, or YAML file that says where images are.
    choice : Choice
        Topics and calibration of a bag, where they are not to be guessed.

    Raises
    ------
    DataError
        If it is not there, in no layout that is known, or what belongs to the layout is missing or wrong.
    """
    if is_bag(path) and not (path.is_dir() and _in_folder(path)):
        return load_bag(path, choice)
    if choice != _ASK:
        raise DataError(f"{path}: --left, --right, --imu and --calibration are of bags, and this is none")
    if path.suffix in _LISTS and not path.is_dir():
        return load_image_list(path)
    if not path.is_dir():
        raise DataError(
            f"{path}: no such folder; name the one that holds mav0, a KITTI raw drive or odometry sequence, "
            "a bag (.bag, .mcap, .db3), or a YAML list of images"
        )
    if is_asl(path):
        return load_asl(path)
    if is_kitti_odometry(path):
        return load_kitti_odometry(path)
    if drive_in(path) is not None:
        return load_kitti_raw(path)
    raise DataError(
        f"{path}: must hold mav0 with cam0 and cam1 (EuRoC, TUM-VI), be a KITTI raw drive with image_00 and "
        "image_01 (the only one below it) or a KITTI odometry sequence with image_0, image_1 and calib.txt, "
        "or a bag, got none of these; docs/guides/bags_and_lists.md tells how any other images are listed"
    )
