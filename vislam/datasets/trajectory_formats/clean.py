"""Rows of a trajectory as everything else may trust them: in order, each once, rotations that are such."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from vislam.base.errors import DataError
from vislam.base.types import Array, BoolArray
from vislam.datasets.trajectory_formats.rows import Rows
from vislam.geometry import se3, so3

_NORM_FOUR_DIGITS = 1e-2
"""How far the norm of a quaternion may be from 1 without a word: some files carry four digits ..."""
_NORM_WITHIN_REASON = 0.1
"""... and how far at all; beyond, the format is another one."""
_ROTATION_SEVEN_DIGITS = 1e-3
"""The same of R^T R and the identity; some files carry four digits of a matrix ..."""
_ROTATION_WITHIN_REASON = 2e-2
_FARTHEST = 1e9
"""A position farther from the origin [m], or a frame or a stamp [s] beyond ten times that, is none."""


def with_quaternions(rows: Rows, quaternion: Array) -> Rows:
    """Rows with the poses of quaternions ``(n, 4)`` x y z w; lost rows (not a number, zero) are dropped.

    Raises
    ------
    DataError
        If the norm of one is not near 1: then the columns are others.
    """
    norm = np.linalg.norm(quaternion, axis=1)
    lost = ~np.isfinite(quaternion).all(axis=1) | (norm == 0.0) | _lost(rows)
    rows = rows.counting("rows_lost", lost, f"hold {_finite(rows)}", _shown(rows, lost, norm))
    rows, quaternion, norm = rows.take(~lost), quaternion[~lost], norm[~lost]
    off = np.abs(norm - 1.0)
    if len(wrong := np.flatnonzero(off > _NORM_WITHIN_REASON)):
        raise DataError(
            f"{rows.path}:{rows.line[wrong[0]]}: must have a quaternion of norm 1, got norm "
            f"{norm[wrong[0]]:.3g}; is the format the right one?"
        )
    coarse = off > _NORM_FOUR_DIGITS
    got = f"norm {norm[np.argmax(coarse)]:.3g}" if coarse.any() else ""
    rows = rows.counting("quaternions_renormalised", coarse, "have a quaternion of norm 1", got)
    turn = Rotation.from_quat(quaternion).as_matrix() if len(rows) else np.empty((0, 3, 3))
    return replace(rows, pose=se3.from_rotation_translation(turn, rows.position))


def with_matrices(rows: Rows, matrix: Array) -> Rows:
    """Rows with poses of matrices ``(n, 3, 4)``; rounded ones are turned into the nearest rotation.

    Raises
    ------
    DataError
        If one is no rotation, or a mirror.
    """
    lost = ~np.isfinite(matrix).all(axis=(1, 2)) | _lost(rows)
    rows = rows.counting("rows_lost", lost, f"hold {_finite(rows)}", "nan")
    rows, matrix = rows.take(~lost), matrix[~lost]
    turn = matrix[:, :, :3]
    off, determinant = so3.defect(turn)
    improper = np.flatnonzero(~(off < _ROTATION_WITHIN_REASON) | (determinant < 0))
    if len(improper):
        first = improper[0]
        raise rows.fail(
            first,
            "a rotation (orthogonal, determinant +1)",
            f"R^T R off by {off[first]:.2g}, determinant {determinant[first]:.3g}",
        )
    coarse = off >= _ROTATION_SEVEN_DIGITS
    got = f"R^T R off by {off[np.argmax(coarse)]:.2g}" if coarse.any() else ""
    rows = rows.counting(
        "rotations_orthogonalised", coarse, "have a rotation (orthogonal, determinant +1)", got
    )
    if coarse.any():
        turn = turn.copy()
        turn[coarse] = Rotation.from_matrix(turn[coarse]).as_matrix()
    return replace(rows, pose=se3.from_rotation_translation(turn, rows.position))


def without_lost(rows: Rows) -> Rows:
    """Rows of positions alone, without the lost ones."""
    lost = _lost(rows)
    return rows.counting("rows_lost", lost, f"hold {_finite(rows)}", "nan").take(~lost)


def in_order(rows: Rows, *, strict: bool) -> Rows:
    """Rows by time or frame, each once; where ``strict``, whatever was or would be mended is rejected.

    Raises
    ------
    DataError
        If a position, stamp or frame is far beyond what there is; if ``strict``, at the first mended row.
    """
    _refuse_absurd(rows)
    at = rows.at
    highest = np.maximum.accumulate(np.concatenate([[-np.inf], at]))[:-1] if len(at) else at
    falling = at < highest
    first = int(np.argmax(falling)) if falling.any() else 0
    got = f"{at[first]:.6f} after {at[first - 1]:.6f}" if falling.any() else ""
    rows = rows.counting("rows_sorted", falling, "have frames or stamps that increase", got)
    order = np.argsort(at, kind="stable")
    rows = rows.take(order)
    at = rows.at
    repeated = np.concatenate([[False], np.diff(at) == 0])[: len(at)]
    if repeated.any():
        whole = rows.position if rows.pose is None else rows.pose.reshape(len(rows), -1)
        same = repeated & np.concatenate([[False], (np.diff(whole, axis=0) == 0).all(axis=1)])
        for what, which in (("duplicates_dropped", same), ("stamps_repeated_dropped", repeated & ~same)):
            first = int(np.argmax(which))
            got = f"{at[first]:.6f} after {at[first - 1]:.6f}"
            rows = rows.counting(what, which, "have frames or stamps that increase", got)
        rows = rows.take(~repeated)
    if strict and rows.first:
        raise DataError(next(iter(rows.first.values())))
    return rows


def _refuse_absurd(rows: Rows) -> None:
    if len(far := np.flatnonzero(np.abs(rows.position).max(axis=1, initial=0.0) > _FARTHEST)):
        raise rows.fail(far[0], f"a position within {_FARTHEST:g} m", f"{rows.position[far[0]].tolist()}")
    at = rows.at
    if len(beyond := np.flatnonzero(~((at >= 0) & (at <= 10 * _FARTHEST)))):
        raise rows.fail(beyond[0], "a frame or a stamp from 0 on", f"{at[beyond[0]]:g}")


def _lost(rows: Rows) -> BoolArray:
    lost = ~np.isfinite(rows.position).all(axis=1)
    return np.asarray(lost if rows.stamp is None else lost | ~np.isfinite(rows.stamp), np.bool_)


def _finite(rows: Rows) -> str:
    """What a row of a format must hold."""
    numbers = {"planar_xy": "3 ", "positions": "4 ", "tum": "8 ", "kitti": "12 ", "kitti360": "13 "}
    return f"{numbers.get(rows.format, '')}finite numbers"


def _shown(rows: Rows, lost: BoolArray, norm: Array) -> str:
    if not lost.any():
        return ""
    return "norm 0" if norm[np.argmax(lost)] == 0.0 else "nan"
