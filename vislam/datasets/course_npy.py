"""Reader of the course's edition of 2025: a ``.npy`` file that holds a pickled dictionary of arrays.

Keys: ``v_t``, ``w_t`` ``(T, 3)`` [m/s, rad/s], body frame; ``timestamps (T,)`` [s]; ``features (4, M, T)`` =
uL, vL, uR, vR [px], -1 where unseen; ``K_l``, ``K_r`` ``(3, 3)``; ``extL_T_imu``, ``extR_T_imu`` ``(4, 4)``,
the body's pose in the left and in the right camera.

A pickle can run any code. This one is read by an unpickler that knows arrays and nothing else.
"""

import pickle
from pathlib import Path
from typing import IO, Any

import numpy as np

from vislam.base.errors import DataError, first_line
from vislam.base.legible import brief
from vislam.base.npy import LARGEST_BYTES
from vislam.base.types import Array
from vislam.core.sequence import Sequence
from vislam.datasets.archive import sha256
from vislam.datasets.checks import LARGEST_STAMP, LARGEST_TWIST, Checks
from vislam.datasets.recording import Opening, Recording
from vislam.datasets.settings import CourseNpy
from vislam.geometry import se3, so3

KEYS = ("v_t", "w_t", "timestamps", "features", "K_l", "K_r", "extL_T_imu", "extR_T_imu")
_RECTIFIED = 1e-3
"""How far a pair may be from rectified: turn [rad], focal length and offsets as shares."""


def read(source: CourseNpy, opening: Opening) -> Recording:
    """Read a course file of 2025 as it stands."""
    return Recording(load_course_npy(opening.find(source.file)))


def load_course_npy(path: Path) -> Sequence:
    """Read a course file of 2025 as it stands; nothing is repaired here.

    Raises
    ------
    DataError
        If the file is no pickled dictionary of arrays, lacks a key, or has a value that cannot be right.
    """
    arrays, checks = _arrays(path), Checks(path)
    stamp = checks.stamps(
        "timestamps", checks.numbers("timestamps", arrays["timestamps"], largest=LARGEST_STAMP)
    )
    frames = len(stamp)
    twist = np.hstack(
        [
            _samples(checks, key, arrays[key], frames=frames, unit=unit)
            for key, unit in (("w_t", "rad/s"), ("v_t", "m/s"))
        ]
    )
    left, right = (
        checks.rigid(key, checks.numbers(key, checks.shaped(key, arrays[key], (4, 4))))
        for key in ("extL_T_imu", "extR_T_imu")
    )
    matrices = [checks.numbers(key, checks.shaped(key, arrays[key], (3, 3))) for key in ("K_l", "K_r")]
    baseline = _baseline(checks, right @ se3.inverse(left), matrices)
    rig = checks.rig("K_l", matrices[0], baseline=baseline, imu_T_cam=se3.inverse(left))
    features = arrays["features"]
    if features.ndim != 3 or features.shape[0] != 4 or features.shape[2] != frames:
        raise checks.fail("features", f"of shape (4, M, {frames})", f"{features.shape}")
    seen = checks.dense("features", features)
    return seen.sequence(path.stem, stamp=stamp, twist=twist, rig=rig, digest=sha256(path))


def _samples(checks: Checks, key: str, values: Array, *, frames: int, unit: str) -> Array:
    """Inertial samples ``(T, 3)``; the other order is taken, too, where it is no question which it is."""
    if values.shape == (3, frames) and frames != 3:
        values = values.T
    checks.shaped(key, values, (frames, 3))
    return checks.numbers(key, values, largest=LARGEST_TWIST, unit=unit)


def _baseline(checks: Checks, right_T_left: Array, matrices: list[Array]) -> float:
    """Distance of the cameras, if the pair is rectified: one K, no turn, the right camera along x."""
    offset = right_T_left[:3, 3]
    length = float(np.linalg.norm(offset))
    baseline = checks.baseline("extR_T_imu", np.array([length]))
    turned = float(np.linalg.norm(so3.log(right_T_left[:3, :3])))
    apart = float(np.abs(offset + length * np.eye(3)[0]).max()) / length
    unlike = float(np.abs(matrices[0] - matrices[1]).max()) / float(matrices[0][0, 0])
    if max(turned, apart, unlike) > _RECTIFIED:
        raise checks.fail(
            "extR_T_imu",
            "that of a rectified pair with extL_T_imu, K_l and K_r: one K, the right camera along x",
            f"a turn of {turned:.2g} rad, the right camera at {(-offset).round(4).tolist()} m, K apart by "
            f"{unlike:.2g} of the focal length; rectify the tracks",
        )
    return baseline


def _arrays(path: Path) -> dict[str, Array]:
    """Arrays of the dictionary, those of numbers as float64 but for the features, which are large."""
    if path.stat().st_size > LARGEST_BYTES:
        raise DataError(f"{path}: must be at most {LARGEST_BYTES:.2g} bytes, got {path.stat().st_size:.2g}")
    try:
        with path.open("rb") as file:
            found = _unpickled(file)
    except DataError:
        raise
    except Exception as error:
        # Whatever a broken pickle makes of itself.
        raise DataError(
            f"{path}: must be a .npy file with a pickled dictionary of arrays, got one that cannot be read "
            f"({brief(first_line(error))}); fetch or copy the file again"
        ) from None
    if not isinstance(found, dict):
        raise DataError(f"{path}: must hold a dictionary of arrays, got {type(found).__name__}")
    missing = [key for key in KEYS if key not in found]
    if missing:
        raise DataError(
            f"{path}: key {', '.join(map(repr, missing))} is missing; the file has "
            f"{brief(', '.join(sorted(map(str, found))))}"
        )
    out = {}
    for key in KEYS:
        value = found[key]
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
            got = value.dtype if isinstance(value, np.ndarray) else type(value).__name__
            raise DataError(f"{path}: '{key}' must be an array of real numbers, got {got}")
        out[key] = value if key == "features" else value.astype(np.float64)
    return out


def _unpickled(file: IO[bytes]) -> Any:
    """Object that a ``.npy`` file holds."""
    version = np.lib.format.read_magic(file)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = reader(file)
    if shape != () or dtype != np.dtype(object):
        raise ValueError(f"an array of {dtype}, shape {shape}")
    held = _ArraysOnly(file).load()
    return held.item() if isinstance(held, np.ndarray) and held.shape == () else held


class _ArraysOnly(pickle.Unpickler):
    """Unpickler that knows NumPy's arrays, their types and scalars; all else ends it."""

    def find_class(self, module: str, name: str) -> Any:
        """Answer for a global; what stands in for ``ndarray`` itself cannot be called."""
        known = {
            "_reconstruct": _empty,
            "_frombuffer": _from_buffer,
            "scalar": _scalar,
            "ndarray": None,
            "dtype": np.dtype,
            "encode": _encode,
        }
        if name in known and module.partition(".")[0] in ("numpy", "_codecs"):
            return known[name]
        raise pickle.UnpicklingError(f"{module}.{name} is no part of an array")


def _empty(*_: Any) -> np.ndarray[Any, Any]:
    """Array that is filled by what follows in the pickle, whatever shape it is said to have before."""
    return np.empty(0, dtype="b")


def _from_buffer(buffer: bytes, dtype: np.dtype[Any], shape: tuple[int, ...], order: Any) -> Array:
    return np.frombuffer(buffer, dtype=dtype).reshape(shape, order=order)


def _scalar(dtype: np.dtype[Any], content: bytes) -> Any:
    return np.frombuffer(content, dtype=dtype)[0]


def _encode(text: str, encoding: str) -> bytes:
    """Bytes as the oldest pickles write them."""
    if encoding not in ("latin1", "latin-1"):
        raise pickle.UnpicklingError(f"bytes in {encoding}")
    return text.encode("latin1")
