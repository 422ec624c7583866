"""Readers by the name of their format, and which format a file has.

A reader is a function of the options of a source and of an :class:`~vislam.datasets.recording.Opening`. Its
first parameter is annotated with a dataclass, the options. Other packages bring theirs by entry points in the
group ``vislam.datasets``.
"""

import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_type_hints

from vislam.base.errors import ConfigError, DataError
from vislam.base.legible import brief
from vislam.base.plugins import installed
from vislam.base.settings import parse
from vislam.datasets.archive import array_names, opened
from vislam.datasets.recording import Opening, Recording
from vislam.datasets.settings import ClementMat, CourseNpy, CourseNpz, RecordedFile, TracksNpz

GROUP = "vislam.datasets"
"""Entry-point group under which readers of other packages are found by the name of their format."""
OWN = {
    "course_npz": "vislam.datasets.course_npz:read",
    "course_npy": "vislam.datasets.course_npy:read",
    "clement_mat": "vislam.datasets.clement_mat:read",
    "tracks_npz": "vislam.datasets.tracks_npz:read",
    "kitti00": "vislam.datasets.kitti00:read",
    "simulation": "vislam.comparison.simulated:read",
}
"""Readers that come along; no other package takes their names."""
_PAGE = "docs/reference/track_format.md"
_PLAIN_ARRAY = b"\x93NUMPY"
_MATLAB = b"MATLAB"
_COURSE = frozenset({"features", "time_stamps", "linear_velocity"})
_TRACKS = frozenset({"frame", "track", "pixels"})

Reader = Callable[[Any, Opening], Recording]


def formats() -> list[str]:
    """Names of all formats that there is a reader for."""
    return sorted(installed(GROUP, OWN))


def read(name: str, options: Any, opening: Opening) -> Recording:
    """Read a source.

    Parameters
    ----------
    name : str
        Its format.
    options : dataclass or mapping
        Its options; a mapping is parsed into the dataclass that the reader asks for.
    opening : Opening

    Raises
    ------
    ConfigError
        If there is no such reader, or it does not take these options.
    DataError
        If the data is missing or cannot be used.
    """
    if name not in (known := formats()):
        raise ConfigError(f"data.source.format: expected one of {', '.join(known)}, got {name}")
    reader: Reader = installed(GROUP, OWN)[name].load()
    if isinstance(options, dict):
        kind = next(iter(get_type_hints(reader).values()), None)
        options = parse(kind, options, at="data.source.options") if isinstance(kind, type) else options
    return reader(options, opening)


def source_of(path: Path) -> RecordedFile:
    """Source of a file by what is in it, whatever its name is.

    Raises
    ------
    DataError
        If it is in none of the formats of one file.
    """
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    name = str(path)
    with path.open("rb") as file:
        start = file.read(128)
    if start.startswith(_PLAIN_ARRAY):
        return CourseNpy(file=name)
    if start.startswith(_MATLAB):
        return ClementMat(file=name)
    if path.suffix == ".npz" or zipfile.is_zipfile(path):
        with opened(path) as archive:
            keys = array_names(archive)
        return _of_arrays(name, keys)
    raise DataError(
        f"{path}: must be a recording, got a file that begins with {start[:8]!r}; read are the course's .npz "
        f"and .npy, the .mat sets of Clement et al. (2015) and .npz files of tracks, which {_PAGE} describes"
    )


def _of_arrays(name: str, keys: set[str]) -> RecordedFile:
    """Source of an archive by its keys; of two formats, it is of the one that more keys are of."""
    course, tracks = len(keys & _COURSE), len(keys & _TRACKS)
    if course == tracks == 0:
        raise DataError(
            f"{name}: key 'features' of a course file or 'frame', 'track' and 'pixels' of a file of "
            f"tracks is missing; the file has {brief(', '.join(sorted(keys)))}; {_PAGE} tells what to write"
        )
    return CourseNpz(file=name) if course >= tracks else TracksNpz(file=name)
