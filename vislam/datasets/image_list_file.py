"""Stereo images of any kind, by a small YAML file that says where images, stamps and calibration are."""

import re
from pathlib import Path
from typing import Literal

import numpy as np
from pydantic.dataclasses import dataclass

from vislam.base.errors import ConfigError, DataError
from vislam.base.fields import STRICT, Positive
from vislam.base.settings import Title, parse
from vislam.base.types import IntArray
from vislam.core.images import ImageRecording, ReferenceFile
from vislam.datasets.calibration_yaml import read_camchain, read_mapping
from vislam.datasets.image_lists import NANOSECONDS, ImageFiles, Listed, paired
from vislam.datasets.inertial_table import inertia_of
from vislam.datasets.settings import Format
from vislam.datasets.text import read_lines, read_table

Unit = Literal["s", "ms", "us", "ns"]
_NANO = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_LISTS = (".txt", ".csv")
_NUMBER = re.compile(r"\d+(?:\.\d+)?")
_LARGEST_NS = 1 << 62


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class CameraFiles:
    """Images of one camera and their stamps."""

    images: str
    """A pattern such as ``left/*.png``, taken in the order of the numbers in the names; or a text file
    (``.txt``, ``.csv``) with a stamp and a file name a line."""
    stamps: str | None = None
    """For a pattern: a text file with a stamp a line, or ``name``: the last number in each file's name."""
    rate_hz: Positive | None = None
    """For a pattern: images a second, where there are no stamps."""
    unit: Unit = "s"
    """Of the stamps."""

    def __post_init__(self) -> None:
        """Reject what says two things, or nothing, of the stamps."""
        given = (self.stamps is not None) + (self.rate_hz is not None)
        if self.images.endswith(_LISTS) and given:
            raise ValueError("a list of images has its stamps: leave out stamps and rate_hz")
        if not self.images.endswith(_LISTS) and given != 1:
            raise ValueError("a pattern of images needs one of stamps and rate_hz")


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class InertialFile:
    """Inertial samples: a line has stamp, angular velocity x y z [rad/s], specific force x y z [m/s^2]."""

    file: str
    """Text file; commas or white space."""
    unit: Unit = "s"
    """Of the stamps."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ReferenceAt:
    """A reference trajectory."""

    file: str
    """Its file."""
    format: Format
    """One of the formats of trajectories."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ImageListFile:
    """A recording. Paths are those from the folder of the file."""

    left: CameraFiles
    """The left camera."""
    right: CameraFiles
    """The right camera."""
    calibration: str
    """A ``camchain`` file of Kalibr: ``cam0`` is the left camera, ``cam1`` the right one."""
    name: Title | None = None
    """Name of the recording; null: that of the file."""
    inertial: InertialFile | None = None
    """Inertial samples, in the clock of the images."""
    reference: ReferenceAt | None = None
    """What runs are scored against."""


def load_image_list(path: Path) -> ImageRecording:
    """List the images that a YAML file names; none is read.

    Raises
    ------
    DataError
        If the file is not as it must be, what it names is missing or cannot be right, or no pair is left.
    """
    try:
        listed = parse(ImageListFile, read_mapping(path))
    except ConfigError as error:
        raise DataError(f"{path}: {error}") from None
    home = path.absolute().parent
    chain = read_camchain(home / listed.calibration)
    left, right, counts = paired(_listed(home, listed.left), _listed(home, listed.right), where=path)
    inertia, dropped = None, dict[str, int]()
    if listed.inertial is not None:
        file = home / listed.inertial.file
        table, _ = read_table(file, columns=7, more=True, comma=_commas(file))
        table[:, 0] *= _NANO[listed.inertial.unit]
        inertia, dropped = inertia_of(table, chain, where=file)
    reference = listed.reference
    return ImageRecording(
        name=path.stem if listed.name is None else listed.name,
        stamp=np.asarray(left.stamp_ns * NANOSECONDS, dtype=np.float64),
        left=left.images,
        right=right.images,
        pair=chain.rectified(home / listed.calibration),
        inertia=inertia,
        reference=None if reference is None else ReferenceFile(home / reference.file, reference.format),
        counts={**counts, **dropped},
    )


def _commas(path: Path) -> bool:
    return any(
        b"," in line for _, line in zip(range(1), (text for _, text in read_lines(path)), strict=False)
    )


def _listed(home: Path, camera: CameraFiles) -> Listed:
    if camera.images.endswith(_LISTS):
        return _of_list(home / camera.images, camera.unit)
    paths = sorted(home.glob(camera.images), key=lambda path: _in_order(str(path)))
    if not paths:
        raise DataError(f"{home / camera.images}: must be a pattern of images, got no file that matches")
    return Listed(_stamps(home, camera, paths), ImageFiles(tuple(paths)))


def _in_order(name: str) -> list[tuple[int, int, str]]:
    """Key by which 10 comes after 9."""
    parts = re.split(r"(\d+)", name)
    return [(1, int(part), "") if part.isdigit() else (0, 0, part) for part in parts]


def _stamps(home: Path, camera: CameraFiles, paths: list[Path]) -> IntArray:
    if camera.rate_hz is not None:
        return np.rint(np.arange(len(paths)) / camera.rate_hz / NANOSECONDS).astype(np.int64)
    assert camera.stamps is not None
    if camera.stamps == "name":
        return np.array([_in_name(path, camera.unit) for path in paths], dtype=np.int64)
    file = home / camera.stamps
    stamps = [
        _nanoseconds(line.split(b",")[0].split()[0], camera.unit, f"{file}:{at}")
        for at, line in read_lines(file)
    ]
    if len(stamps) != len(paths):
        raise DataError(f"{file}: must have a stamp for each of {len(paths)} images, got {len(stamps)}")
    return np.array(stamps, dtype=np.int64)


def _in_name(path: Path, unit: Unit) -> int:
    numbers = _NUMBER.findall(path.stem)
    if not numbers:
        raise DataError(f"{path}: must have its stamp in its name, got no number")
    return _nanoseconds(numbers[-1].encode(), unit, str(path))


def _of_list(path: Path, unit: Unit) -> Listed:
    stamps, files = [], []
    for number, line in read_lines(path):
        stamp, _, name = line.replace(b",", b" ", 1).partition(b" ")
        plain = name.strip().decode(errors="replace")
        if not plain or "\0" in plain:
            raise DataError(f"{path}:{number}: must be a stamp and a file name, got {line[:40]!r}")
        stamps.append(_nanoseconds(stamp, unit, f"{path}:{number}"))
        files.append(path.parent / plain)
    return Listed(np.array(stamps, dtype=np.int64), ImageFiles(tuple(files)))


def _nanoseconds(text: bytes, unit: Unit, where: str) -> int:
    """A stamp as a whole number [ns], exact where the text is whole: a double has 53 bits."""
    try:
        value = int(text) * _NANO[unit] if text.isdigit() else round(float(text) * _NANO[unit])
    except (ValueError, OverflowError):
        value = _LARGEST_NS
    if abs(value) >= _LARGEST_NS:
        raise DataError(f"{where}: must have a stamp [{unit}], got {text[:20].decode(errors='replace')!r}")
    return value
