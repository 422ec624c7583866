"""Reader of the ``.mat`` files of Clement et al. (2015): tracks, twist, reference poses and landmarks.

Clement, Peretroukhin, Lambert, Kelly, *The Battle for Filter Supremacy: A Comparative Study of the
Multi-State Constraint Kalman Filter and the Sliding Window Filter* (CRV 2015). Keys, T frames and M columns:

``y_k_j (4, T, M)``
    uL, vL, uR, vR [px], -1 where unseen.
``t (1, T)``
    Camera times [s].
``v_vk_vk_i``, ``w_vk_vk_i (3, >= T)``
    Velocity and angular velocity in the vehicle frame [m/s, rad/s].
``C_c_v (3, 3)``, ``rho_v_c_v (3, 1)``
    Rotation from the vehicle's axes to the camera's; place of the camera in the vehicle [m].
``theta_vk_i``, ``r_i_vk_i (3, >= T)``
    Reference poses: rotation vector of the vehicle in the world [rad], and its place [m].
``rho_i_pj_i (3, M)``
    Reference landmarks [m], where the set has them.
``fu``, ``fv``, ``cu``, ``cv``, ``b``
    Intrinsics [px] and baseline [m].
"""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat
from scipy.io.matlab import MatReadError

from vislam.base.errors import DataError, first_line
from vislam.base.legible import brief
from vislam.base.types import Array
from vislam.core.reference import Reference
from vislam.datasets.archive import sha256
from vislam.datasets.checks import LARGEST_NUMBER, LARGEST_STAMP, LARGEST_TWIST, Checks
from vislam.datasets.recording import Opening, Recording
from vislam.datasets.settings import ClementMat
from vislam.geometry import se3, so3

KEYS = (
    *("y_k_j", "t", "v_vk_vk_i", "w_vk_vk_i", "C_c_v", "rho_v_c_v", "theta_vk_i", "r_i_vk_i"),
    *("fu", "fv", "cu", "cv", "b"),
)
_LANDMARKS = "rho_i_pj_i"
_BY_FRAME = ("y_k_j", "t", "v_vk_vk_i", "w_vk_vk_i", "theta_vk_i", "r_i_vk_i")
"""Keys whose second axis is that of the frames."""
_BROKEN = (MatReadError, ValueError, TypeError, KeyError, IndexError, OSError, NotImplementedError)
_BROKEN_BYTES = (EOFError, OverflowError, zlib.error, struct.error, AttributeError)


def read(source: ClementMat, opening: Opening) -> Recording:
    """Read a set as it stands, with its reference."""
    return load_clement_mat(opening.find(source.file), steps=source.steps)


def load_clement_mat(path: Path, *, steps: tuple[int, int] | None = None) -> Recording:
    """Read a ``.mat`` file as it stands; nothing is repaired here.

    Parameters
    ----------
    path : Path
    steps : tuple of int, optional
        First and last step, counted from 1; all if left out.

    Raises
    ------
    DataError
        If the file is no MATLAB file up to version 7.2, lacks a key, has a value that cannot be right, or
        ends before the steps do.
    """
    mat, checks = _variables(path), Checks(path)
    if steps is not None:
        mat = _cut(mat, steps, path)
    stamp = checks.stamps("t", checks.numbers("t", mat["t"], largest=LARGEST_STAMP))
    frames = len(stamp)
    pixels = mat["y_k_j"]
    if pixels.ndim != 3 or pixels.shape[0] != 4 or pixels.shape[1] != frames:
        raise checks.fail("y_k_j", f"of shape (4, {frames}, M)", f"{pixels.shape}")
    seen = checks.dense("y_k_j", pixels.transpose(0, 2, 1))
    velocity, rate = (
        _of_frames(checks, key, mat[key], frames=frames, unit=unit)
        for key, unit in (("v_vk_vk_i", "m/s"), ("w_vk_vk_i", "rad/s"))
    )
    camera = np.eye(4)
    camera[:3, :3] = checks.shaped("C_c_v", mat["C_c_v"], (3, 3)).T
    camera[:3, 3] = checks.numbers("rho_v_c_v", checks.shaped("rho_v_c_v", mat["rho_v_c_v"], (3, 1)))[:, 0]
    fu, fv, cu, cv = (float(checks.shaped(key, mat[key], (1, 1))[0, 0]) for key in ("fu", "fv", "cu", "cv"))
    rig = checks.rig(
        "fu, fv, cu, cv",
        np.array([[fu, 0.0, cu], [0.0, fv, cv], [0.0, 0.0, 1.0]]),
        baseline=checks.baseline("b", mat["b"]),
        imu_T_cam=checks.rigid("C_c_v", camera),
    )
    sequence = seen.sequence(
        path.stem if steps is None else f"{path.stem}_{steps[0]}_{steps[1]}",
        stamp=stamp,
        twist=np.hstack([rate, velocity]),
        rig=rig,
        digest=sha256(path),
    )
    points = _landmarks(checks, mat.get(_LANDMARKS), columns=pixels.shape[2])
    return Recording(
        sequence,
        _reference(checks, mat, frames=frames),
        None if points is None else points[seen.track],
    )


def _cut(mat: dict[str, Array], steps: tuple[int, int], path: Path) -> dict[str, Array]:
    """Arrays of some steps; what has no frames, or is of another shape than it should be, stays."""
    frames = mat["t"].shape[-1] if mat["t"].ndim else 0
    if steps[1] > frames:
        raise DataError(
            f"{path}: source.steps must be within 1 to {frames}, the frames of the file, got {list(steps)}"
        )
    wanted = slice(steps[0] - 1, steps[1])
    return {
        key: value[:, wanted] if key in _BY_FRAME and value.ndim > 1 else value for key, value in mat.items()
    }


def _reference(checks: Checks, mat: dict[str, Array], *, frames: int) -> Reference:
    turn, place = (_of_frames(checks, key, mat[key], frames=frames) for key in ("theta_vk_i", "r_i_vk_i"))
    pose = se3.from_rotation_translation(so3.exp(turn), place)
    return Reference(
        name="poses of the file",
        limits="twist and poses of these sets may come from one instrument: dead reckoning is near it then",
        frame=np.arange(frames),
        position=pose[:, :3, 3],
        pose=pose,
        imu_T_point=np.eye(4),
    )


def _landmarks(checks: Checks, values: Array | None, *, columns: int) -> Array | None:
    """Reference landmarks ``(M, 3)`` [m], or None."""
    if values is None:
        return None
    return checks.numbers(_LANDMARKS, checks.shaped(_LANDMARKS, values, (3, columns))).T


def _of_frames(checks: Checks, key: str, values: Array, *, frames: int, unit: str = "") -> Array:
    """Three numbers for each frame, ``(T, 3)``; what the file has beyond its frames is left out."""
    if values.ndim != 2 or values.shape[0] != 3 or values.shape[1] < frames:
        raise checks.fail(key, f"of shape (3, {frames}) or longer", f"{values.shape}")
    largest = LARGEST_TWIST if unit else LARGEST_NUMBER
    return np.ascontiguousarray(checks.numbers(key, values[:, :frames].T, largest=largest, unit=unit))


def _variables(path: Path) -> dict[str, Array]:
    """Arrays of real numbers by their names; only those that are read."""
    found: dict[str, Any]
    try:
        found = loadmat(path, variable_names=[*KEYS, _LANDMARKS])
    except (*_BROKEN, *_BROKEN_BYTES) as error:
        raise DataError(
            f"{path}: must be a MATLAB file of version 5 to 7.2, got one that cannot be read "
            f"({brief(first_line(error))}); save it with -v7, or copy it again"
        ) from None
    missing = [key for key in KEYS if key not in found]
    if missing:
        raise DataError(
            f"{path}: key {', '.join(map(repr, missing))} is missing: only the sets of Clement et al. (2015) "
            "are read from MATLAB files; write others as docs/reference/track_format.md says"
        )
    out = {}
    for key in (*KEYS, _LANDMARKS):
        value = found.get(key)
        if value is None:
            continue
        if not isinstance(value, np.ndarray) or value.dtype.kind not in "fiu":
            got = value.dtype if isinstance(value, np.ndarray) else type(value).__name__
            raise DataError(f"{path}: '{key}' must be an array of real numbers, got {got}")
        out[key] = value.astype(np.float64)
    return out
