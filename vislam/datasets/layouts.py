"""Trajectories in the layouts of other tools: evo, rpg_trajectory_evaluation, OpenVINS, smfeval, KITTI."""

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.base.files import replace_whole
from vislam.base.types import Array
from vislam.core.stamped import Stamped
from vislam.geometry.pose_covariance import CovarianceConvention, from_right

_LOWER_SIX = tuple((row, column) for row in range(6) for column in range(row + 1))
_UPPER_THREE = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_SQUARE = CovarianceConvention("position_first", "right")
_OPENVINS = CovarianceConvention("rotation_first", "split")
_STAMP, _VALUE, _MATRIX = "%.9f", "%.17g", "%.17e"
_HEADER = "timestamp tx ty tz qx qy qz qw"


def write_layouts(folder: Path, algorithm: str, rows: Stamped, reference: Stamped) -> list[Path]:
    """Write a trajectory and its reference as each tool wants them; return the files.

    ``evo/<name>.tum``, ``rpg/<name>/stamped_traj_estimate.txt`` with ``stamped_groundtruth.txt``,
    ``openvins/<name>.txt`` and ``openvins/truth.txt``, ``smfeval/<name>.SQUARE`` where it has covariances,
    ``kitti/<name>.txt``. What has no attitudes is written without a turn.
    """
    plain, truth = _lines(rows), _lines(reference)
    files = {
        folder / "evo" / f"{algorithm}.tum": (plain, ""),
        folder / "evo" / "reference.tum": (truth, ""),
        folder / "rpg" / algorithm / "stamped_traj_estimate.txt": (plain, _HEADER),
        folder / "rpg" / algorithm / "stamped_groundtruth.txt": (truth, _HEADER),
        folder / "openvins" / "truth.txt": (truth, _HEADER),
    }
    cov = rows.cov
    whole = cov is not None and bool(np.isfinite(cov).all())
    openvins = np.column_stack([plain, _openvins(rows.poses, cov)]) if whole and cov is not None else plain
    names = " Pr11 Pr12 Pr13 Pr22 Pr23 Pr33 Pt11 Pt12 Pt13 Pt22 Pt23 Pt33" if whole else ""
    files[folder / "openvins" / f"{algorithm}.txt"] = (openvins, _HEADER + names)
    for path, (table, header) in files.items():
        _write(path, table, [_STAMP, *[_VALUE] * (table.shape[1] - 1)], header, "# ")
    written = list(files)
    if whole and cov is not None:
        written.append(folder / "smfeval" / f"{algorithm}.SQUARE")
        write_square(written[-1], algorithm, rows.stamp, rows.poses, cov)
    for name, side in ((algorithm, rows), ("reference", reference)):
        written.append(folder / "kitti" / f"{name}.txt")
        _write(written[-1], side.poses[:, :3].reshape(-1, 12), [_MATRIX] * 12, "", "")
    return written


def write_square(path: Path, algorithm: str, stamp: Array, pose: Array, cov: Array) -> None:
    """Write poses and covariances ``(n, 6, 6)``, (omega, v) on the right, as smfeval's SQUARE file."""
    turned = from_right(pose, cov, _SQUARE)
    packed = np.column_stack([turned[:, row, column] for row, column in _LOWER_SIX])
    header = "\n".join(
        f"#%{key} {value}"
        for key, value in {
            "FORMAT": "SQUARE/0.3",
            "REPRESENTATION": "gaussian_se3",
            "POSE_FRAME": "world",
            "BODY_FRAME": "body",
            "GAUGE": "se3",
            "TIMESTAMP_UNIT": "seconds",
            "ALGORITHM": algorithm,
            "ALGORITHM_VERSION": "0",
            "TANGENT_CONVENTION": "right_perturbation",
            "TANGENT_ORDER": "translation_rotation",
            "ROTATION_PARAM": "axis_angle",
        }.items()
    )
    table = np.column_stack([_table(stamp, pose), packed])
    _write(path, table, [_STAMP, *[_VALUE] * (table.shape[1] - 1)], header, "")


def _openvins(pose: Array, cov: Array) -> Array:
    """Upper triangles of the covariances of rotation and position, as OpenVINS' recorder has them."""
    turned = from_right(pose, cov, _OPENVINS)
    blocks = [turned[:, :3, :3], turned[:, 3:, 3:]]
    return np.column_stack([block[:, row, column] for block in blocks for row, column in _UPPER_THREE])


def _lines(rows: Stamped) -> Array:
    return _table(rows.stamp, rows.poses)


def _table(stamp: Array, pose: Array) -> Array:
    quaternion = Rotation.from_matrix(pose[:, :3, :3]).as_quat()
    return np.column_stack([stamp, pose[:, :3, 3], quaternion])


def _write(path: Path, table: Array, form: list[str], header: str, comments: str) -> None:
    with replace_whole(path) as temporary:
        np.savetxt(temporary, table, fmt=form, header=header, comments=comments)
