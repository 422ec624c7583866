"""Reader of the course's ``.npz`` files, every edition: validates, then keeps only what was seen.

The ``features`` array is 98 % sentinels and 1.3 GB in the largest edition, so it is streamed out of
the archive piece by piece and never held.
"""

import hashlib
import math
import zipfile
import zlib
from pathlib import Path
from typing import IO, Any

import numpy as np

from vislam.data.sequence import Sequence
from vislam.errors import DataError
from vislam.geometry import se3
from vislam.sensors import StereoRig
from vislam.types import Array, IntArray

_UNSEEN = -1.0
_CHUNK_VALUES = 1 << 20
_SMALL_ARRAY_BYTES = 1 << 26
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
    except (zipfile.BadZipFile, zlib.error, EOFError, OSError, NotImplementedError) as error:
        raise DataError(f"{path}: not a whole npz archive ({error}); fetch or copy the file again") from None


class _Reader:
    """One open archive and the checks on what comes out of it."""

    def __init__(self, archive: zipfile.ZipFile, path: Path) -> None:
        self._archive = archive
        self._path = path
        self._keys = {name.removesuffix(".npy") for name in archive.namelist()}

    def sequence(self) -> Sequence:
        angular = self._one_of("angular_velocity", "rotational_velocity")
        extrinsic = self._one_of("imu_T_cam", "cam_T_imu")
        for key in ("time_stamps", "linear_velocity", "K", "b", "features"):
            self._one_of(key)
        stamp = self._stamps()
        frames = len(stamp)
        twist = np.vstack([self._small(angular, (3, frames)), self._small("linear_velocity", (3, frames))])
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
        raise DataError(f"{self._path}: key {wanted} is missing; the file has {sorted(self._keys)}")

    def _open(self, key: str) -> tuple[IO[bytes], tuple[int, ...], bool, np.dtype[Any]]:
        """Open a member behind its header: the stream, and the shape, order and type of the array."""
        name = f"{key}.npy"
        stream = self._archive.open(name)
        try:
            version = np.lib.format.read_magic(stream)
            read = (
                np.lib.format.read_array_header_1_0
                if version == (1, 0)
                else (np.lib.format.read_array_header_2_0)
            )
            shape, fortran, dtype = read(stream)
        except ValueError as error:
            raise self._fail(key, "a plain numpy array", f"an unreadable header ({error})") from None
        if dtype.hasobject or dtype.kind not in "fiu":
            raise self._fail(key, "a plain array of real numbers (pickled objects are refused)", f"{dtype}")
        expected = math.prod(shape) * dtype.itemsize
        got = self._archive.getinfo(name).file_size - stream.tell()
        if expected != got:
            raise self._fail(key, f"{expected} bytes long as its shape {shape} says", f"{got} bytes")
        return stream, shape, fortran, dtype

    def _small(self, key: str, shape: tuple[int, ...] | None = None) -> Array:
        """Read a whole array of finite numbers, float64, of the given shape."""
        stream, found, fortran, dtype = self._open(key)
        with stream:
            if shape is not None and found != shape:
                raise self._fail(key, f"of shape {shape}", f"{found}")
            if math.prod(found) * dtype.itemsize > _SMALL_ARRAY_BYTES:
                raise self._fail(key, f"smaller than {_SMALL_ARRAY_BYTES} bytes", f"shape {found}")
            flat = np.frombuffer(stream.read(), dtype=dtype).astype(np.float64)
        if not np.all(np.isfinite(flat)):
            raise self._fail(
                key, "free of NaN and infinity", f"{np.count_nonzero(~np.isfinite(flat))} of them"
            )
        return flat.reshape(found, order="F" if fortran else "C")

    def _stamps(self) -> Array:
        stamp = self._small("time_stamps")
        if stamp.size != max(stamp.shape, default=0) or stamp.size < 2:
            raise self._fail("time_stamps", "of shape (1, T) with T at least 2", f"{stamp.shape}")
        stamp = stamp.reshape(-1)
        wrong = np.flatnonzero(np.diff(stamp) <= 0)
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
        if not (np.allclose(matrix, plain, atol=1e-9) and min(fx, fy, cx, cy) > 0):
            raise self._fail(
                "K",
                "an intrinsic matrix [[fx, 0, cx], [0, fy, cy], [0, 0, 1]] with positive entries [px]",
                f"{matrix.tolist()}",
            )
        return {"fx": float(fx), "fy": float(fy), "cx": float(cx), "cy": float(cy)}

    def _baseline(self) -> float:
        value = self._small("b")
        if value.size != 1 or value.reshape(-1)[0] <= 0:
            raise self._fail("b", "one baseline > 0 [m]", f"{value.tolist()}")
        return float(value.reshape(-1)[0])

    def _rigid_transform(self, key: str) -> Array:
        pose = self._small(key, (4, 4))
        rotation = pose[:3, :3]
        off = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
        if off > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0 or np.any(pose[3] != [0, 0, 0, 1]):
            raise self._fail(
                key,
                "a rigid transform (rotation, determinant +1, last row 0 0 0 1)",
                f"R^T R off by {off:.2g}, determinant {np.linalg.det(rotation):.3g}, "
                f"last row {pose[3].tolist()}",
            )
        u, _, vt = np.linalg.svd(rotation)
        return se3.from_rotation_translation(u @ vt, pose[:3, 3])

    def _observations(self, frames: int) -> tuple[IntArray, IntArray, Array, int]:
        """Frame, track and pixels of each stereo observation, by frame, and how many were partial."""
        stream, shape, fortran, dtype = self._open("features")
        if len(shape) != 3 or shape[0] != 4 or shape[2] != frames:
            raise self._fail("features", f"of shape (4, M, {frames})", f"{shape}")
        with stream:
            position, value = _stream_seen(stream, dtype)
        if not np.all(np.isfinite(value)):
            raise self._fail(
                "features", "free of NaN and infinity", f"{np.count_nonzero(~np.isfinite(value))} of them"
            )
        component, track, frame = np.unravel_index(position, shape, order="F" if fortran else "C")
        order = np.lexsort((component, track, frame))
        component, track, frame, value = component[order], track[order], frame[order], value[order]
        cell = frame * shape[1] + track
        _, start, length = np.unique(cell, return_index=True, return_counts=True)
        whole = start[length == 4]
        return frame[whole], track[whole], value[whole[:, None] + np.arange(4)], int(np.sum(length != 4))


def _stream_seen(stream: IO[bytes], dtype: np.dtype[Any]) -> tuple[IntArray, Array]:
    """Flat positions and values of all entries that are not the sentinel."""
    positions, values, start = [], [], 0
    while piece := stream.read(_CHUNK_VALUES * dtype.itemsize):
        chunk = np.frombuffer(piece, dtype=dtype)
        seen = np.flatnonzero(chunk != _UNSEEN)
        positions.append(seen + start)
        values.append(chunk[seen].astype(np.float64))
        start += len(chunk)
    if not positions:
        return np.empty(0, np.int64), np.empty(0)
    return np.concatenate(positions), np.concatenate(values)


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
