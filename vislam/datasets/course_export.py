"""Writer of the course's ``.npz`` format, for what is simulated; the same sequence gives the same bytes."""

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from vislam.base.errors import DataError
from vislam.base.npy import LARGEST_BYTES
from vislam.base.types import Array
from vislam.core.sequence import Sequence

_UNSEEN = -1.0
_EPOCH = (1980, 1, 1, 0, 0, 0)
"""Date of every member, so that a file says nothing of when it was written."""


def write_course_npz(path: Path, sequence: Sequence) -> None:
    """Write a sequence as a course file that ``load_course_npz`` reads.

    The keys are ``time_stamps (1, T)`` [s], ``features (4, M, T)`` (uL, vL, uR, vR) with -1 for unseen [px],
    ``linear_velocity (3, T)`` [m/s], ``angular_velocity (3, T)`` [rad/s], ``K (3, 3)``, ``b`` [m] and
    ``imu_T_cam (4, 4)``. M is the largest track id plus one. What breaks off leaves half a file: ``path`` is
    best the temporary name that ``replace_whole`` gives.

    Raises
    ------
    DataError
        If the inertial samples are not one a frame at the camera stamps, or the tracks are too many for a
        reader.
    """
    if not np.array_equal(sequence.inertial_stamp, sequence.stamp):
        raise DataError(f"{sequence.name}: the format has one inertial sample a frame, at the camera stamps")
    columns = int(sequence.track.max(initial=-1)) + 1
    size = 4 * columns * len(sequence) * np.dtype(np.float64).itemsize
    if size > LARGEST_BYTES:
        raise DataError(
            f"{sequence.name}: features of {columns} tracks in {len(sequence)} frames take {size:.1e} bytes: "
            f"readers take at most {LARGEST_BYTES:.1e}; simulate fewer frames"
        )
    rig = sequence.rig
    small = {
        "time_stamps": sequence.stamp[None],
        "angular_velocity": sequence.twist[:, :3].T,
        "linear_velocity": sequence.twist[:, 3:].T,
        "K": np.array([[rig.fx, 0.0, rig.cx], [0.0, rig.fy, rig.cy], [0.0, 0.0, 1.0]]),
        "b": np.array(rig.baseline),
        "imu_T_cam": rig.imu_T_cam,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        for key, value in small.items():
            with _member(archive, key) as stream:
                np.lib.format.write_array(stream, value, allow_pickle=False)
        with _member(archive, "features") as stream:
            shape = (4, columns, len(sequence))
            header = {"descr": "<f8", "fortran_order": True, "shape": shape}
            np.lib.format.write_array_header_1_0(stream, header)
            for block in _frames(sequence, columns):
                stream.write(block.tobytes())


@contextmanager
def _member(archive: zipfile.ZipFile, key: str) -> Iterator[IO[bytes]]:
    """Open a member of the archive for writing."""
    info = zipfile.ZipInfo(f"{key}.npy", _EPOCH)
    info.compress_type = zipfile.ZIP_DEFLATED
    with archive.open(info, "w", force_zip64=True) as stream:
        yield stream


def _frames(sequence: Sequence, columns: int) -> Iterator[Array]:
    """Features ``(M, 4)`` of frame after frame: the whole array would take gigabytes."""
    for begin, end in zip(sequence.offset[:-1], sequence.offset[1:], strict=True):
        block = np.full((columns, 4), _UNSEEN, dtype="<f8")
        block[sequence.track[begin:end]] = sequence.pixels[begin:end]
        yield block
