"""Inertial samples from the OXTS folder of a KITTI raw drive, synced (10 Hz) or not (100 Hz).

A folder has ``data/*.txt``, one file a sample with 30 numbers, and ``timestamps.txt``, one line a sample.
Of the numbers (``dataformat.txt`` of KITTI's raw data kit, counted from 0) 8, 9, 10 are vf, vl, vu [m/s] and
17, 18, 19 are wx, wy, wz [rad/s]. The rates are about the body's own axes, forward, left, up. The velocities
are levelled, that is vf and vl parallel to the earth's surface and vu across it, so such data wants the
repair ``navigation_frame_velocity``.
"""

import hashlib
import re
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from vislam.base.errors import DataError
from vislam.base.types import Array, IntArray
from vislam.core.imu import ImuSeries
from vislam.core.sequence import Sequence
from vislam.datasets.inertial_table import possible
from vislam.datasets.text import read_lines, read_table

_COLUMNS = 30
_TWIST = [17, 18, 19, 8, 9, 10]
"""Columns of (omega, v)."""
GYRO, ACCELEROMETER = slice(17, 20), slice(11, 14)
"""Columns of the angular velocity and of the specific force, forward, left, up [rad/s, m/s^2]."""
_MOST_SAMPLES = 1_000_000
_MOST_DIGITS = 20
_UNCOVERED = 1.0
"""The samples may begin and end so far inside the recording [s]; beyond them the nearest one is held."""
_STAMP = re.compile(rb"((?:19|20)\d\d-\d\d-\d\d \d\d:\d\d:\d\d)(?:\.(\d{1,9}))?")


def with_oxts(sequence: Sequence, folder: Path, *, camera_timestamps: Path | None) -> Sequence:
    """Replace the inertial samples of a recording by those of an OXTS folder.

    Parameters
    ----------
    sequence : Sequence
    folder : Path
        The one that holds ``data`` and ``timestamps.txt``.
    camera_timestamps : Path or None
        ``image_00/timestamps.txt`` of the same drive, one line a frame. It is in the clock of the samples, so
        the first camera stamp laid on the recording's first stamp puts every sample in its place. Without
        it, sample k is taken for the time of frame k, as in a synced folder; such samples are too far
        apart for raw inertia, and the sequence has none.

    Raises
    ------
    DataError
        If something is missing, unreadable or of a wrong count, or if stamps do not increase. A sample that
        repeats the stamp of the one before is dropped and counted.
    """
    number, table = _samples(folder)
    duplicates, imu = 0, None
    if camera_timestamps is None:
        if len(table) != len(sequence):
            raise DataError(
                f"{folder}: must have a sample for each of the {len(sequence)} frames, got {len(table)}; "
                "name the camera_timestamps of the drive, or take its synced folder"
            )
        stamp = sequence.stamp
    else:
        stamp = _in_clock_of(sequence, folder / "timestamps.txt", camera_timestamps, number=number)
        fresh = np.diff(stamp, prepend=-np.inf) != 0
        duplicates = int(np.sum(~fresh))
        stamp, table = stamp[fresh], table[fresh]
        _check(stamp, folder / "timestamps.txt", sequence.stamp)
        imu = ImuSeries(stamp, *possible(table[:, GYRO], table[:, ACCELEROMETER], where=folder))
    parts = [sequence.digest.encode(), stamp.tobytes(), table.tobytes()]
    return replace(
        sequence,
        inertial_stamp=stamp,
        twist=table[:, _TWIST],
        vertical_velocity=np.full(len(stamp), np.nan),
        digest=hashlib.sha256(b"|".join(parts)).hexdigest(),
        counts={
            **sequence.counts,
            "inertial_samples": len(stamp),
            "inertial_duplicates": duplicates,
            "inertial_longest_gap_ms": round(1e3 * float(np.diff(stamp).max())),
        },
        imu=imu,
    )


def read_oxts(folder: Path) -> tuple[IntArray, Array]:
    """Read all samples of a folder as they are.

    Returns
    -------
    stamp_ns : (S,)
        Stamps [ns], local time as :func:`read_timestamps` has it.
    table : (S, 30)
        The numbers of each sample.

    Raises
    ------
    DataError
        If something is missing, unreadable or of a wrong count.
    """
    number, table = _samples(folder)
    return _own_stamps(folder / "timestamps.txt", number), table


def _samples(folder: Path) -> tuple[IntArray, Array]:
    """Numbers that name the files, ``(S,)``, in order, and the samples in them, ``(S, 30)``."""
    paths = list((folder / "data").glob("*.txt"))
    if not 2 <= len(paths) <= _MOST_SAMPLES:
        raise DataError(
            f"{folder}: must have 2 to {_MOST_SAMPLES} files data/*.txt, got {len(paths)}; "
            "name the folder oxts of a KITTI raw drive"
        )
    rows = np.empty((len(paths), _COLUMNS))
    numbered = _by_number(paths)
    for row, path in zip(rows, numbered.values(), strict=True):
        table, _ = read_table(path, columns=_COLUMNS)
        if len(table) != 1:
            raise DataError(f"{path}: must hold one line of {_COLUMNS} numbers, got {len(table)}")
        row[:] = table[0]
    return np.array([min(number, _MOST_SAMPLES) for number in numbered]), rows


def _by_number(paths: list[Path]) -> dict[int, Path]:
    """Files by their numbers, in order, whatever their padding."""
    numbered: dict[int, Path] = {}
    for path in sorted(paths):
        if not (path.stem.isascii() and path.stem.isdigit() and len(path.stem) <= _MOST_DIGITS):
            raise DataError(
                f"{path}: must be named by the number of its sample, as 0000000000.txt; rename or remove it"
            )
        other = numbered.setdefault(int(path.stem), path)
        if other is not path:
            raise DataError(f"{path}: must be the only sample of its number, got {other.name}; remove one")
    return {number: numbered[number] for number in sorted(numbered)}


def _own_stamps(path: Path, number: IntArray) -> IntArray:
    """Stamps of the samples ``(S,)`` [ns]: a line each, or the line of each number if some are missing."""
    own = read_timestamps(path)
    if len(own) == len(number):
        return own
    if len(own) < len(number) or number[-1] >= len(own):
        raise DataError(
            f"{path}: must have a line for each of the {len(number)} files in data, got {len(own)}"
            + (f", and sample {number[-1]} is none of them" if len(own) > len(number) else "")
        )
    return np.asarray(own[number])


def _in_clock_of(sequence: Sequence, path: Path, camera_timestamps: Path, *, number: IntArray) -> Array:
    """Stamps of the samples in the clock of the sequence, ``(S,)`` [s]."""
    own, camera = _own_stamps(path, number), read_timestamps(camera_timestamps)
    if len(camera) != len(sequence):
        raise DataError(
            f"{camera_timestamps}: must have a line for each of the {len(sequence)} frames, got "
            f"{len(camera)}; is it of the same drive, and synced as the recording is?"
        )
    apart = np.abs(1e-9 * (camera - camera[0]) - (sequence.stamp - sequence.stamp[0]))
    if apart.max() > 0.5 * float(np.median(np.diff(sequence.stamp))):
        raise DataError(
            f"{camera_timestamps}: must run with the recording's stamps, got {apart.max():.3f} s off at "
            f"frame {int(apart.argmax())}; is it of the same drive?"
        )
    # Nanoseconds are integers, which lose nothing; the difference to the first camera stamp is small.
    return np.asarray(sequence.stamp[0] + 1e-9 * (own - camera[0]))


def _check(stamp: Array, path: Path, frames: Array) -> None:
    """Raise DataError unless the stamps increase and cover the frames."""
    falling = np.flatnonzero(np.diff(stamp) <= 0)
    if len(falling):
        step = stamp[falling[0]] - stamp[falling[0] + 1]
        raise DataError(
            f"{path}: must increase, got {len(falling)} steps back, the first by {step:.6f} s after "
            f"{stamp[falling[0]] - stamp[0]:.3f} s; sort them, or take the synced folder"
        )
    if len(stamp) < 2 or stamp[0] > frames[0] + _UNCOVERED or stamp[-1] < frames[-1] - _UNCOVERED:
        raise DataError(
            f"{path}: must cover the recording, {frames[0]:.3f} to {frames[-1]:.3f} s, got {stamp[0]:.3f} to "
            f"{stamp[-1]:.3f} s in its clock; is it of the same drive?"
        )


def read_timestamps(path: Path) -> IntArray:
    """Read stamps as ``2011-09-30 12:40:25.066400000``, one a line, as integers [ns].

    They are Karlsruhe's local time and name no zone, so they are good for differences within a drive only.
    """
    stamps = [_nanoseconds(line, where=f"{path}:{number}") for number, line in read_lines(path)]
    if not 2 <= len(stamps) <= _MOST_SAMPLES:
        raise DataError(f"{path}: must have 2 to {_MOST_SAMPLES} stamps, got {len(stamps)}")
    return np.array(stamps, dtype=np.int64)


def _nanoseconds(line: bytes, *, where: str) -> int:
    found = _STAMP.fullmatch(line)
    try:
        if found is None:
            raise ValueError
        second = datetime.strptime(found[1].decode(), "%Y-%m-%d %H:%M:%S").replace(tzinfo=UTC)
    except ValueError:
        shown = line[:40].decode(errors="replace")
        raise DataError(f"{where}: must be a stamp as 2011-09-30 12:40:25.066400000, got {shown!r}") from None
    return 10**9 * int(second.timestamp()) + int((found[2] or b"").ljust(9, b"0"))
