"""Reader of the course's ``.npz`` files, every edition: validates, then keeps only what was seen.

The ``features`` array is 98 % sentinels and 1.3 GB in the largest edition, so it is streamed out of
the archive piece by piece and never held.
"""

import zipfile
from pathlib import Path

import numpy as np

from vislam.base.npy import PackedArray
from vislam.base.types import Array, IntArray
from vislam.core.sequence import Sequence
from vislam.datasets.archive import Arrays, opened, sha256
from vislam.datasets.checks import LARGEST_STAMP, LARGEST_TWIST, UNSEEN, Observations
from vislam.datasets.recording import Opening, Recording
from vislam.datasets.settings import CourseNpz
from vislam.geometry import se3

_MOST_SEEN_VALUES = 1 << 24
"""Values of ``features`` that are no sentinels, four an observation; more would take gigabytes to sort."""
KEYS = frozenset({"time_stamps", "linear_velocity", "K", "b", "features"})
"""Keys that all editions have."""


def read(source: CourseNpz, opening: Opening) -> Recording:
    """Read a course file as it stands."""
    return Recording(load_course_npz(opening.find(source.file)))


def load_course_npz(path: Path) -> Sequence:
    """Read a course file as it stands; nothing is repaired here.

    The key of the extrinsic is believed: ``imu_T_cam`` is the camera's pose in the body, ``cam_T_imu`` (older
    editions) its inverse.

    Raises
    ------
    DataError
        If the file is missing, cut short, holds pickled objects, lacks a key, or has a value that
        cannot be right (shape, NaN, order of stamps, K, baseline, extrinsic).
    """
    with opened(path) as archive:
        return _Reader(archive, path).sequence()


class _Reader:
    """One open archive and the checks on what comes out of it."""

    def __init__(self, archive: zipfile.ZipFile, path: Path) -> None:
        self._arrays = Arrays(archive, path)
        self._checks = self._arrays.checks
        self._path = path

    def sequence(self) -> Sequence:
        has, checks = self._arrays.one_of, self._checks
        angular = has("angular_velocity", "rotational_velocity")
        extrinsic = has("imu_T_cam", "cam_T_imu")
        for key in ("time_stamps", "linear_velocity", "K", "b", "features"):
            has(key)
        small = self._arrays.small
        stamp = checks.stamps("time_stamps", small("time_stamps", largest=LARGEST_STAMP))
        frames = len(stamp)
        units = {angular: "rad/s", "linear_velocity": "m/s"}
        twist = np.vstack(
            [small(key, (3, frames), largest=LARGEST_TWIST, unit=unit) for key, unit in units.items()]
        )
        pose = checks.rigid(extrinsic, small(extrinsic, (4, 4)))
        if extrinsic == "cam_T_imu":
            pose = se3.inverse(pose)
        baseline = checks.baseline("b", small("b"))
        rig = checks.rig("K", small("K", (3, 3)), baseline=baseline, imu_T_cam=pose)
        seen = self._observations(frames)
        return seen.sequence(
            self._path.stem,
            stamp=stamp,
            twist=np.ascontiguousarray(twist.T),
            rig=rig,
            digest=sha256(self._path),
        )

    def _observations(self, frames: int) -> Observations:
        packed = self._arrays.open("features")
        with packed.stream:
            if len(packed.shape) != 3 or packed.shape[0] != 4 or packed.shape[2] != frames:
                raise self._checks.fail("features", f"of shape (4, M, {frames})", f"{packed.shape}")
            columns = packed.shape[1]
            position, value = self._seen(packed)
        self._checks.numbers("features", value)
        entry = _by_frame(position, columns, frames, fortran=packed.fortran)
        order = np.argsort(entry)
        entry, value = entry[order], value[order]
        cell = entry // 4
        whole = np.flatnonzero((entry[:-3] % 4 == 0) & (entry[3:] - entry[:-3] == 3))
        incomplete = int(np.count_nonzero(np.diff(cell, prepend=-1))) - len(whole)
        frame, track = cell[whole] // max(columns, 1), cell[whole] % max(columns, 1)
        return Observations(frame, track, value[whole[:, None] + np.arange(4)], incomplete)

    def _seen(self, packed: PackedArray) -> tuple[IntArray, Array]:
        """Flat positions and values of all entries that are not the sentinel."""
        positions, values, start, count = [np.empty(0, np.int64)], [np.empty(0)], 0, 0
        for chunk in packed.chunks():
            seen = np.flatnonzero(chunk != UNSEEN)
            count += len(seen)
            if count > _MOST_SEEN_VALUES:
                raise self._checks.fail(
                    "features", f"mostly {UNSEEN:g}, at most {_MOST_SEEN_VALUES} values being others", "more"
                )
            positions.append(seen + start)
            values.append(chunk[seen].astype(np.float64))
            start += len(chunk)
        return np.concatenate(positions), np.concatenate(values)


def _by_frame(position: IntArray, columns: int, frames: int, *, fortran: bool) -> IntArray:
    """From flat positions in an array (4, columns, frames) to those of (frames, columns, 4)."""
    if fortran:
        return position
    component, rest = np.divmod(position, max(columns * frames, 1))
    track, frame = np.divmod(rest, frames)
    return (frame * columns + track) * 4 + component
