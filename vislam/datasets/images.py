"""A folder of stereo images in whichever layout it is."""

from pathlib import Path

from vislam.base.errors import DataError
from vislam.core.images import ImageRecording
from vislam.datasets.asl import is_asl, load_asl
from vislam.datasets.kitti_raw import drive_in, load_kitti_raw


def is_images(folder: Path) -> bool:
    """Whether a path is a folder of images in a layout that is known."""
    return folder.is_dir() and (is_asl(folder) or drive_in(folder) is not None)


def open_images(folder: Path) -> ImageRecording:
    """List the images of a folder; none is read.

    Raises
    ------
    DataError
        If it is no folder, in no layout that is known, or what belongs to the layout is missing or wrong.
    """
    if not folder.is_dir():
        raise DataError(f"{folder}: no such folder; name the one that holds mav0, or a KITTI raw drive")
    if is_asl(folder):
        return load_asl(folder)
    if drive_in(folder) is not None:
        return load_kitti_raw(folder)
    raise DataError(
        f"{folder}: must hold mav0 with cam0 and cam1 (EuRoC, TUM-VI), or be a KITTI raw drive with "
        "image_00 and "
        "image_01 (the only one below it), got neither"
    )
