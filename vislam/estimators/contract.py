"""What the loop demands of what an estimator returns; what breaks it ends that run and no other.

The values come back as copies of the shapes and types that a :class:`vislam.core.run.Run` keeps, so that an
estimator may go on using its own arrays.
"""

from collections.abc import Mapping
from inspect import signature
from typing import Any

import numpy as np

from vislam.base.errors import ContractError
from vislam.base.legible import quoted
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.frame import Frame
from vislam.core.schema import SHORT_NAME
from vislam.core.step import Final, State, Step
from vislam.core.trajectory import Landmarks, Poses
from vislam.geometry import se3, so3

_ROTATION_TOLERANCE = 1e-4
"""How far R^T R may be from the identity: what float32 and long products leave."""
_ROUNDING = 1e-3
"""Asymmetry and negative eigenvalues of a covariance up to this share of its largest entry are rounding: a
landmark's is the difference of much larger ones."""


def check_interface(estimator: Any) -> None:
    """Check that ``process`` can be called as the loop does.

    Raises
    ------
    ContractError
        Says how it must be called, and what has taken the place of the argument that it once had.
    """
    try:
        takes = signature(estimator.process)
    except ValueError:
        # Compiled code need not say; it answers for itself when it is called.
        return
    try:
        takes.bind(None)
    except TypeError:
        raise ContractError(
            f"process must take (frame), got {takes}: what was rejected is now ~frame.stereo.usable"
        ) from None


def checked_step(step: Any, frame: Frame, sizes: Mapping[str, int]) -> Step:
    """Check the answer to a frame, given the sizes of the states that earlier frames had.

    Raises
    ------
    ContractError
        Names the field, what is expected of it and what came.
    """
    if not isinstance(step, Step):
        raise ContractError(f"process must return a Step, got {type(step).__name__}")
    count = len(frame.stereo)
    return Step(
        pose=_poses("pose", step.pose, (4, 4)),
        pose_cov=_covariance("pose_cov", step.pose_cov, (6, 6)),
        states=_states(step.states, sizes),
        nis=_level("nis", step.nis),
        dof=_count("dof", step.dof),
        log_likelihood=_scalar("log_likelihood", step.log_likelihood),
        used=_mask("used", step.used, count),
        gated=_mask("gated", step.gated, count),
        spurious_information=_optional("spurious_information", step.spurious_information, (6,)),
    )


def checked_final(final: Any, frames: int) -> Final:
    """Check the final estimate of a sequence of so many frames.

    Raises
    ------
    ContractError
        Names the field, what is expected of it and what came.
    """
    if not isinstance(final, Final):
        raise ContractError(f"finalize must return a Final, got {type(final).__name__}")
    up = _optional("up", final.up, (3,))
    if up is not None and abs(float(np.linalg.norm(up)) - 1.0) > _ROTATION_TOLERANCE:
        raise ContractError(f"up must be a unit vector, got {quoted(up)}")
    return Final(
        trajectory=_trajectory(final.trajectory, frames),
        map=_map(final.map),
        fused=_pairs("fused", final.fused),
        gated=_pairs("gated", final.gated),
        counts=_counts(final.counts),
        events=_events(final.events),
        up=up,
        fit=_fit(final.fit),
        lagged=_lagged(final.lagged, frames),
    )


def _states(value: Any, sizes: Mapping[str, int]) -> dict[str, State]:
    if not isinstance(value, Mapping):
        raise ContractError(f"states must be a State by each name, got {type(value).__name__}")
    return {_name(key): _state(f"states.{key}", state, sizes.get(key)) for key, state in value.items()}


def _name(key: Any) -> str:
    if not isinstance(key, str) or not SHORT_NAME.fullmatch(key):
        raise ContractError(
            f"states must have names of letters, digits and _, at most 32, a letter first, got {quoted(key)}"
        )
    return key


def _state(name: str, state: Any, size: int | None) -> State:
    if not isinstance(state, State):
        raise ContractError(f"{name} must be a State, got {type(state).__name__}")
    shape = np.shape(state.value) if size is None else (size,)
    if len(shape) != 1 or not shape[0]:
        raise ContractError(f"{name}.value must be (m,) numbers, got {quoted(state.value)}")
    value = _finite(f"{name}.value", _array(f"{name}.value", state.value, shape))
    if state.sigma is None:
        return State(value)
    sigma = _array(f"{name}.sigma", state.sigma, shape)
    if np.isnan(sigma).all():
        return State(value)
    if _finite(f"{name}.sigma", sigma).min() < 0.0:
        raise ContractError(f"{name}.sigma must be at least 0, got {sigma.min():g}")
    return State(value, sigma)


def _trajectory(value: Any, frames: int) -> Poses | None:
    if value is None:
        return None
    if not isinstance(value, Poses):
        raise ContractError(f"trajectory must be Poses(array), got {type(value).__name__}")
    return _all_poses("trajectory", value, frames)


def _lagged(value: Any, frames: int) -> dict[int, Poses]:
    if not isinstance(value, Mapping) or not all(isinstance(poses, Poses) for poses in value.values()):
        raise ContractError(f"lagged must be Poses(array) by lag, got {quoted(value)}")
    return {_count("lagged: a lag", lag): _all_poses(f"lagged[{lag}]", value[lag], frames) for lag in value}


def _all_poses(name: str, value: Poses, frames: int) -> Poses:
    return Poses(
        _poses(f"{name}.world_T_imu", value.world_T_imu, (frames, 4, 4)),
        _covariance(f"{name}.cov", value.cov, (frames, 6, 6)),
    )


def _map(value: Any) -> Landmarks | None:
    if value is None:
        return None
    if not isinstance(value, Landmarks):
        raise ContractError(f"map must be Landmarks(track, points_world), got {type(value).__name__}")
    track = _integers("map.track", value.track)
    count = len(track)
    if count and (track.min() < 0 or len(np.unique(track)) != count):
        raise ContractError(f"map.track must hold ids from 0 on, each once, got {quoted(track)}")
    return Landmarks(
        track,
        _finite("map.points_world", _array("map.points_world", value.points_world, (count, 3))),
        _covariance("map.points_cov", value.points_cov, (count, 3, 3)),
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


def _pairs(name: str, value: Any) -> tuple[IntArray, IntArray] | None:
    if value is None:
        return None
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise ContractError(f"{name} must be a pair of frames and tracks, got {quoted(value)}")
    frame, track = _integers(f"{name} frames", value[0]), _integers(f"{name} tracks", value[1])
    if len(frame) != len(track):
        raise ContractError(f"{name} must be as many frames as tracks, got {len(frame)} and {len(track)}")
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
