"""What the loop demands of what an estimator returns; what breaks it ends that run and no other.

The values come back as copies of the shapes and types that a :class:`vislam.core.run.Run` keeps, so that an
estimator may go on using its own arrays.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from vislam.base.errors import ContractError
from vislam.base.legible import quoted
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.estimator import Estimate, StepRecord
from vislam.core.sequence import Frame
from vislam.geometry import se3, so3

_ROTATION_TOLERANCE = 1e-4
"""How far R^T R may be from the identity: what float32 and long products leave."""
_ROUNDING = 1e-3
"""Asymmetry and negative eigenvalues of a covariance up to this share of its largest entry are rounding: a
landmark's is the difference of much larger ones."""


def checked_step(step: Any, frame: Frame) -> StepRecord:
    """Check the answer to a frame.

    Raises
    ------
    ContractError
        Names the field, what is expected of it and what came.
    """
    if not isinstance(step, StepRecord):
        raise ContractError(f"process must return a StepRecord, got {type(step).__name__}")
    count = len(frame.track)
    return replace(
        step,
        world_T_imu=_poses("world_T_imu", step.world_T_imu, (4, 4)),
        pose_cov=_covariance("pose_cov", step.pose_cov, (6, 6)),
        bias=_optional("bias", step.bias, (6,)),
        bias_sigma=_optional("bias_sigma", step.bias_sigma, (6,)),
        nis=_level("nis", step.nis),
        dof=_count("dof", step.dof),
        log_likelihood=_scalar("log_likelihood", step.log_likelihood),
        used=_mask("used", step.used, count),
        gated=_mask("gated", step.gated, count),
        world_gained=_optional("world_gained", step.world_gained, (6,)),
    )


def checked_estimate(estimate: Any, causal: Array) -> Estimate:
    """Check the final estimate, which may leave the poses as they were at the steps, ``(T, 4, 4)``.

    Raises
    ------
    ContractError
        Names the field, what is expected of it and what came.
    """
    if not isinstance(estimate, Estimate):
        raise ContractError(f"finalize must return an Estimate, got {type(estimate).__name__}")
    frames = len(causal)
    poses = causal if estimate.world_T_imu is None else estimate.world_T_imu
    track = _integers("track", estimate.track)
    landmarks = len(track)
    if landmarks and (track.min() < 0 or len(np.unique(track)) != landmarks):
        raise ContractError(f"track must hold ids from 0 on, each once, got {quoted(track)}")
    up = _optional("up", estimate.up, (3,))
    if up is not None and abs(float(np.linalg.norm(up)) - 1.0) > _ROTATION_TOLERANCE:
        raise ContractError(f"up must be a unit vector, got {quoted(up)}")
    return replace(
        estimate,
        world_T_imu=_poses("world_T_imu", poses, (frames, 4, 4)),
        pose_cov=_covariance("pose_cov", estimate.pose_cov, (frames, 6, 6)),
        track=track,
        points_world=_finite("points_world", _array("points_world", estimate.points_world, (landmarks, 3))),
        points_cov=_covariance("points_cov", estimate.points_cov, (landmarks, 3, 3)),
        counts=_counts(estimate.counts),
        up=up,
        fused=_fused(estimate.fused),
        events=_events(estimate.events),
        fit=_fit(estimate.fit),
    )


def _array(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Copy of real numbers of a shape, float64."""
    try:
        raw = np.asarray(value)
    except ValueError:
        raise ContractError(f"{name} must be {shape} numbers, got a ragged {type(value).__name__}") from None
    if raw.dtype.kind not in "fiu":
        raise ContractError(f"{name} must be {shape} real numbers, got {_kind(value, raw)}")
    if raw.shape != shape:
        raise ContractError(f"{name} must be {shape}, got {raw.shape}")
    return np.array(raw, dtype=np.float64)


def _kind(value: Any, raw: np.ndarray[Any, Any]) -> str:
    return f"an array of {raw.dtype}" if isinstance(value, np.ndarray) else type(value).__name__


def _finite(name: str, array: Array) -> Array:
    broken = np.count_nonzero(~np.isfinite(array))
    if broken:
        raise ContractError(f"{name} must be finite, got {broken} of {array.size} numbers that are not")
    return array


def _optional(name: str, value: Any, shape: tuple[int, ...]) -> Array | None:
    return None if value is None else _finite(name, _array(name, value, shape))


def _poses(name: str, value: Any, shape: tuple[int, ...]) -> Array:
    pose = _finite(name, _array(name, value, shape))
    # Far from a rotation the products overflow, which is an answer too.
    with np.errstate(over="ignore", invalid="ignore"):
        rigid = se3.is_rigid(pose, tolerance=_ROTATION_TOLERANCE)
        if rigid.all():
            return pose
        off, determinant = so3.defect(pose[..., :3, :3])
    first = int(np.flatnonzero(~rigid)[0])
    where = "" if pose.ndim == 2 else f" at frame {first}"
    raise ContractError(
        f"{name} must be rigid transforms (a rotation of determinant 1, last row 0 0 0 1){where}, got "
        f"R^T R off by {np.ravel(off)[first]:.2g}, determinant {np.ravel(determinant)[first]:.3g}"
    )


def _covariance(name: str, value: Any, shape: tuple[int, ...]) -> Array | None:
    """Copy of covariances; one that is NaN throughout is not given."""
    if value is None:
        return None
    cov = _array(name, value, shape)
    given = ~np.isnan(cov).all(axis=(-2, -1))
    known = cov[given] if cov.ndim == 3 else cov[None][np.atleast_1d(given)]
    _finite(name, known)
    scale = np.abs(known).max(axis=(-2, -1), initial=0.0)
    skew = np.abs(known - np.swapaxes(known, -2, -1)).max(axis=(-2, -1), initial=0.0)
    if np.any(skew > _ROUNDING * scale):
        raise ContractError(f"{name} must be symmetric, got differences up to {skew.max():.2g}")
    lowest = np.linalg.eigvalsh(known).min(axis=-1, initial=np.inf)
    if np.any(lowest < -_ROUNDING * scale):
        raise ContractError(
            f"{name} must be positive semi-definite, got an eigenvalue of {lowest.min():.3g} "
            f"at a largest entry of {scale[int(lowest.argmin())]:.3g}"
        )
    return cov


def _mask(name: str, value: Any, count: int) -> BoolArray:
    """Copy of a mask; none marks nothing."""
    if value is None:
        return np.zeros(count, bool)
    raw = np.asarray(value)
    if raw.shape != (count,):
        raise ContractError(f"{name} must be ({count},), got {raw.shape}")
    if raw.dtype != np.bool_:
        raise ContractError(f"{name} must be a mask of bool, got {_kind(value, raw)}")
    return raw.copy()


def _integers(name: str, value: Any) -> IntArray:
    raw = np.asarray(value)
    if raw.ndim != 1 or raw.dtype.kind not in "iu":
        raise ContractError(f"{name} must be integers (m,), got {_kind(value, raw)} of shape {raw.shape}")
    return raw.astype(np.int64)


def _scalar(name: str, value: Any) -> float:
    return float(_array(name, value, ()))


def _level(name: str, value: Any) -> float:
    number = _scalar(name, value)
    if not 0.0 <= number < np.inf:
        raise ContractError(f"{name} must be finite and at least 0, got {number:g}")
    return number


def _count(name: str, value: Any) -> int:
    number = _level(name, value)
    if number != int(number):
        raise ContractError(f"{name} must be a whole number, got {number:g}")
    return int(number)


def _counts(value: Any) -> dict[str, int]:
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise ContractError(f"counts must be whole numbers by name, got {type(value).__name__}")
    return {key: _count(f"counts.{key}", number) for key, number in value.items()}


def _events(value: Any) -> tuple[str, ...]:
    if not isinstance(value, list | tuple) or not all(isinstance(line, str) for line in value):
        raise ContractError(f"events must be a tuple of lines of text, got {quoted(value)}")
    return tuple(value)


def _fused(value: Any) -> tuple[IntArray, IntArray] | None:
    if value is None:
        return None
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ContractError(f"fused must be a pair of frames and tracks, got {quoted(value)}")
    frame, track = _integers("fused frames", value[0]), _integers("fused tracks", value[1])
    if len(frame) != len(track):
        raise ContractError(f"fused must be as many frames as tracks, got {len(frame)} and {len(track)}")
    return frame, track


def _fit(value: Any) -> tuple[float, int] | None:
    if value is None:
        return None
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ContractError(f"fit must be a sum of squares and its degrees of freedom, got {quoted(value)}")
    freedom = _scalar("fit: degrees of freedom", value[1])
    if freedom != int(freedom):
        raise ContractError(f"fit: degrees of freedom must be a whole number, got {freedom:g}")
    return _level("fit: sum of squares", value[0]), int(freedom)
