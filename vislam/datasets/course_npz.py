"""Reader of the course's ``.npz`` files, every edition: validates, then keeps only what was seen.

The ``features`` array is 98 % sentinels and 1.3 GB in the largest edition, so it is streamed out of
the archive piece by piece and never held.
"""

import hashlib
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np

from vislam.base.errors import DataError, first_line
from vislam.base.legible import brief
from vislam.base.npy import ArrayError, PackedArray, open_array
from vislam.base.types import Array, IntArray
from vislam.core.sequence import Sequence
from vislam.geometry import se3, so3
from vislam.models import StereoRig

_UNSEEN = -1.0
_MOST_SMALL_VALUES = 1 << 22
_MOST_SEEN_VALUES = 1 << 24
"""Values of ``features`` that are no sentinels, four an observation; more would take gigabytes to sort."""
_LARGEST_STAMP = 1e20
"""Nanoseconds since 1970 are read, to be told from seconds by their steps."""
_LARGEST_NUMBER = 1e6
"""Of pixels and lengths [px, m]: beyond it a number is no measurement, and squares of squares overflow."""
_LARGEST_TWIST = 200.0
"""Of velocities [rad/s, m/s]; no camera that is carried is faster."""
_SHORTEST_STEP = 1e-6
"""Frames closer in time than this are none [s]."""
_SHORTEST_BASELINE = 1e-4
# RuntimeError and ValueError: an unknown method, an encrypted member, an offset that is none.
_BROKEN = (zipfile.BadZipFile, zlib.error, struct.error, EOFError, OSError, RuntimeError, ValueError)
_ROTATION_TOLERANCE = 1e-3
"""How far R^T R may be from the identity; the files carry seven digits."""


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
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    try:
        with zipfile.ZipFile(path) as archive:
            return _Reader(archive, path).sequence()
    except DataError:
        raise
    except _BROKEN as error:
        raise DataError(
            f"{path}: not a whole npz archive ({brief(first_line(error))}); fetch or copy the file again"
        ) from None


class _Reader:
    """One open archive and the checks on what comes out of it."""

    def __init__(self, archive: zipfile.ZipFile, path: Path) -> None:
        self._archive = archive
        self._path = path
        names = archive.namelist()
        self._keys = {name.removesuffix(".npy") for name in names if name.endswith(".npy")}

    def sequence(self) -> Sequence:
        angular = self._one_of("angular_velocity", "rotational_velocity")
        extrinsic = self._one_of("imu_T_cam", "cam_T_imu")
        for key in ("time_stamps", "linear_velocity", "K", "b", "features"):
            self._one_of(key)
        stamp = self._stamps()
        frames = len(stamp)
        units = {angular: "rad/s", "linear_velocity": "m/s"}
        twist = np.vstack(
            [self._small(key, (3, frames), largest=_LARGEST_TWIST, unit=unit) for key, unit in units.items()]
        )
        pose = self._rigid_transform(extrinsic)
        if extrinsic == "cam_T_imu":
            pose = se3.inverse(pose)
        rig = StereoRig(**self._intrinsics(), baseline=self._baseline(), imu_T_cam=pose)
        frame, track, pixels, incomplete = self._observations(frames)
        offset = np.concatenate([[0], np.cumsum(np.bincount(frame, minlength=frames))])
        return Sequence(
            name=self._path.stem,
            stamp=stamp,
            inertial_stamp=stamp,
            twist=np.ascontiguousarray(twist.T),
            climb_rate=np.full(frames, np.nan),
            rig=rig,
            offset=offset.astype(np.int64),
            track=track,
            pixels=pixels,
            row=np.arange(len(track)),
            digest=_sha256(self._path),
            counts={
                "frames": frames,
                "feature_columns": len(np.unique(track)),
                "observations_read": len(track),
                "observations_incomplete": incomplete,
            },
        )

    def _fail(self, key: str, expected: str, got: str) -> DataError:
        return DataError(f"{self._path}: '{key}' must be {expected}, got {got}")

    def _one_of(self, *keys: str) -> str:
        for key in keys:
            if key in self._keys:
                return key
        wanted = " or ".join(f"'{key}'" for key in keys)
        raise DataError(
            f"{self._path}: key {wanted} is missing; the file has {brief(', '.join(sorted(self._keys)))}"
        )

    def _open(self, key: str) -> PackedArray:
        try:
            return open_array(self._archive, f"{key}.npy")
        except ArrayError as error:
            raise DataError(f"{self._path}: '{key}' {error}") from None

    def _small(
        self,
        key: str,
        shape: tuple[int, ...] | None = None,
        *,
        largest: float = _LARGEST_NUMBER,
        unit: str = "",
    ) -> Array:
        """Read a whole array of finite numbers, float64, of the given shape."""
        packed = self._open(key)
        if shape is not None and packed.shape != shape:
            raise self._fail(key, f"of shape {shape}", f"{packed.shape}")
        if packed.size > _MOST_SMALL_VALUES:
            raise self._fail(key, f"of at most {_MOST_SMALL_VALUES} numbers", f"shape {packed.shape}")
        with packed.stream:
            flat = np.concatenate([np.empty(0), *packed.chunks()])
        self._check_numbers(key, flat, largest, unit=unit)
        return flat.reshape(packed.shape, order="F" if packed.fortran else "C")

    def _check_numbers(self, key: str, values: Array, largest: float, *, unit: str = "") -> None:
        infinite = np.count_nonzero(~np.isfinite(values))
        if infinite:
            raise self._fail(key, "free of NaN and infinity", f"{infinite} of them")
        beyond = np.flatnonzero(np.abs(values) > largest)
        if len(beyond):
            got = f"{values[beyond[0]]:g}"
            if unit:
                got = f"{got}: is it in another unit?"
            raise self._fail(key, f"made of numbers up to {largest:g}{unit and ' '}{unit}", got)

    def _stamps(self) -> Array:
        stamp = self._small("time_stamps", largest=_LARGEST_STAMP)
        if stamp.size != max(stamp.shape, default=0) or stamp.size < 2:
            raise self._fail("time_stamps", "of shape (1, T) with T at least 2", f"{stamp.shape}")
        stamp = stamp.reshape(-1)
        wrong = np.flatnonzero(np.diff(stamp) < _SHORTEST_STEP)
        if len(wrong):
            raise self._fail(
                "time_stamps",
                "increasing [s]",
                f"{stamp[wrong[0] + 1]:.6f} after {stamp[wrong[0]]:.6f} at frame {wrong[0] + 1}",
            )
        return stamp

    def _intrinsics(self) -> dict[str, float]:
        matrix = self._small("K", (3, 3))
        fx, fy, cx, cy = matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]
        plain = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        if not (np.allclose(matrix, plain, atol=1e-9) and min(fx, fy) >= 1.0 and min(cx, cy) > 0):
            raise self._fail(
                "K",
                "an intrinsic matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]], fx, fy >= 1, cx, cy > 0 [px]",
                f"{matrix.tolist()}",
            )
        return {"fx": float(fx), "fy": float(fy), "cx": float(cx), "cy": float(cy)}

    def _baseline(self) -> float:
        value = self._small("b").reshape(-1)
        if len(value) != 1 or value[0] < _SHORTEST_BASELINE:
            raise self._fail("b", "one baseline > 0 [m]", f"{value[:2].tolist()} of {len(value)}")
        return float(value[0])

    def _rigid_transform(self, key: str) -> Array:
        pose = self._small(key, (4, 4))
        rotation = pose[:3, :3]
        off, determinant = so3.defect(rotation)
        if off > _ROTATION_TOLERANCE or determinant < 0 or np.any(pose[3] != [0, 0, 0, 1]):
            raise self._fail(
                key,
                "a rigid transform (rotation, determinant +1, last row 0 0 0 1)",
                f"R^T R off by {off:.2g}, determinant {determinant:.3g}, last row {pose[3].tolist()}",
            )
        u, _, vt = np.linalg.svd(rotation)
        return se3.from_rotation_translation(u @ vt, pose[:3, 3])

    def _observations(self, frames: int) -> tuple[IntArray, IntArray, Array, int]:
        """Frame, track and pixels of each stereo observation, by frame, and how many were partial."""
        packed = self._open("features")
        if len(packed.shape) != 3 or packed.shape[0] != 4 or packed.shape[2] != frames:
            raise self._fail("features", f"of shape (4, M, {frames})", f"{packed.shape}")
        columns = packed.shape[1]
        with packed.stream:
            position, value = self._seen(packed)
        self._check_numbers("features", value, _LARGEST_NUMBER)
        entry = _by_frame(position, columns, frames, fortran=packed.fortran)
        order = np.argsort(entry)
        entry, value = entry[order], value[order]
        cell = entry // 4
        whole = np.flatnonzero((entry[:-3] % 4 == 0) & (entry[3:] - entry[:-3] == 3))
        incomplete = int(np.count_nonzero(np.diff(cell, prepend=-1))) - len(whole)
        frame, track = cell[whole] // max(columns, 1), cell[whole] % max(columns, 1)
        return frame, track, value[whole[:, None] + np.arange(4)], incomplete

    def _seen(self, packed: PackedArray) -> tuple[IntArray, Array]:
        """Flat positions and values of all entries that are not the sentinel."""
        positions, values, start, count = [np.empty(0, np.int64)], [np.empty(0)], 0, 0
        for chunk in packed.chunks():
            seen = np.flatnonzero(chunk != _UNSEEN)
            count += len(seen)
            if count > _MOST_SEEN_VALUES:
                raise self._fail(
                    "features", f"mostly {_UNSEEN:g}, at most {_MOST_SEEN_VALUES} values being others", "more"
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


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
