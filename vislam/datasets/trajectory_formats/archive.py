"""Our own npz files: what ``vislam compare`` writes beside its results."""

import zipfile
from pathlib import Path

import numpy as np

from vislam.base.errors import DataError, first_line
from vislam.base.types import Array
from vislam.datasets.trajectory_formats import clean
from vislam.datasets.trajectory_formats.options import ReadOptions
from vislam.datasets.trajectory_formats.rows import Rows
from vislam.geometry.pose_covariance import OURS

_MOST_NUMBERS = 10**8


def npz(path: Path, options: ReadOptions) -> Rows:
    """``stamp``, ``world_T_imu`` and maybe ``pose_cov``, as :func:`vislam.datasets.export.write_npz`."""
    arrays = read_arrays(path, ("stamp", "world_T_imu"), ("pose_cov",))
    stamp, pose = arrays["stamp"], arrays["world_T_imu"]
    if stamp.ndim != 1 or pose.shape != (len(stamp), 4, 4):
        raise DataError(
            f"{path}: must hold stamp (T,) and world_T_imu (T, 4, 4), got {stamp.shape} and {pose.shape}"
        )
    cov = arrays.get("pose_cov")
    if cov is not None and cov.shape != (len(stamp), 6, 6):
        raise DataError(f"{path}: must hold pose_cov (T, 6, 6), got {cov.shape}")
    rows = Rows(
        path,
        "npz",
        np.arange(1, len(stamp) + 1),
        pose[:, :3, 3],
        stamp=stamp,
        cov=cov,
        convention=None if cov is None else OURS,
    )
    return clean.with_matrices(rows, pose[:, :3])


def read_arrays(path: Path, needed: tuple[str, ...], optional: tuple[str, ...] = ()) -> dict[str, Array]:
    """Arrays of real numbers of an npz file, by name; a DataError says what is wrong with it."""
    found: dict[str, Array] = {}
    try:
        with np.load(path, allow_pickle=False) as archive:
            missing = [name for name in needed if name not in archive]
            if missing:
                got = ", ".join(archive.files[:8]) or "nothing"
                raise DataError(f"{path}: must hold {' and '.join(needed)}, got {got}")
            for name in (*needed, *(name for name in optional if name in archive)):
                array = archive[name]
                if array.size > _MOST_NUMBERS or array.dtype.kind not in "fiu":
                    raise DataError(f"{path}: must hold numbers as {name}, got {array.dtype} {array.shape}")
                found[name] = array.astype(float)
    except DataError:
        raise
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile, NotImplementedError) as error:
        raise DataError(f"{path}: not an npz file of arrays ({first_line(error)})") from None
    return found
