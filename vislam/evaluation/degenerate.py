"""Runs whose estimate is no answer to the data: nothing fused, blown up, or nearly everything rejected.

Their numbers are computed like all others, but they are marked and not ranked: dead reckoning under another
name can well be closest to a reference.
"""

import numpy as np

from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.record import Record
from vislam.core.run import Estimate, Run
from vislam.core.trajectory import Poses
from vislam.geometry import se3, so3

_LEAST_SHARE = 0.05
"""Share of the observations below which what was fused is not the data that was given."""
_LARGEST_JUMP = 10.0
"""Times the length, or the turn, of a usual fast step by the inertial data, beyond which a step is none."""
_USUAL_PERCENTILE = 95.0
_SURE = 5.0
"""Standard deviations of the pose before by which an update may move the pose."""
_SMALLEST_TURN = 0.35
"""A turn below this is no jump, however smooth the rest of the path is [rad]."""
_LARGEST_PER_FREEDOM = 1000.0
"""Normalised squared residuals per degree of freedom: beyond, they are 30 times their stated noise."""


def degeneracies(run: Run, record: Record, estimate: Estimate | None = None) -> tuple[str, ...]:
    """Reasons why an estimate, by default the final one, is degenerate, one line each.

    None for a sound one, nor for that of a run from elsewhere.
    """
    if run.blind or run.elsewhere or not len(run.stamp):
        return ()
    final = estimate in (None, run.estimates[-1])
    return (
        *_fused(run, record),
        *_jumps(run, run.poses(estimate), record),
        *(_fit(run) if final else ()),
        *_innovations(run),
    )


def _fused(run: Run, record: Record) -> tuple[str, ...]:
    bound = record.common_set is not None and run.name not in record.common_set.exempt
    given = (
        int(np.count_nonzero(record.common_set.kept))
        if bound and record.common_set
        else len(record.given.track)
    )
    fused = int(np.count_nonzero(run.used))
    if not given or not run.complete:
        return ()
    if not fused:
        return ("fused no observation: it is dead reckoning under another name",)
    if fused < _LEAST_SHARE * given:
        return (f"fused {fused} of {given} observations only",)
    return ()


def _jumps(run: Run, poses: Poses, record: Record) -> tuple[str, ...]:
    """Steps of an estimate that neither the inertial data nor the run's own covariance allow.

    A step by no more than an estimate could be off is a correction. Where the run has no covariance of the
    frame before, that is what it estimated last, and what it went since without any observation.
    """
    consecutive = np.flatnonzero(np.diff(run.frame) == 1)
    if record.step_twist is None or not len(consecutive):
        return ()
    step = se3.inverse(poses.world_T_imu[consecutive]) @ poses.world_T_imu[consecutive + 1]
    moved = np.linalg.norm(step[:, :3, 3], axis=1)
    turned = np.linalg.norm(so3.log(step[:, :3, :3]), axis=1)
    dt = np.diff(record.stamp, prepend=record.stamp[0])
    turn, way = (np.linalg.norm(part, axis=1) * dt for part in np.split(record.step_twist, 2, axis=1))
    frame = run.frame[consecutive + 1]
    variance, told = _told(poses.covariances)
    sure_turn, sure_way = (
        _SURE * np.sqrt(part.sum(axis=1))[consecutive] for part in np.split(variance, 2, axis=1)
    )
    blind_turn, blind_way = (
        np.where(told, 0.0, part)[consecutive] for part in _blind(run, record, np.stack([turn, way]))
    )
    farthest = _LARGEST_JUMP * np.maximum(way[frame], np.percentile(way, _USUAL_PERCENTILE))
    widest = _LARGEST_JUMP * np.maximum(turn[frame], np.percentile(turn, _USUAL_PERCENTILE))
    farthest, widest = farthest + sure_way + blind_way, widest + sure_turn + blind_turn
    widest = np.maximum(widest, _SMALLEST_TURN)
    # A velocity of exactly 0 in every step was not measured, and allows no judgement of a distance.
    steps = _beyond("steps", moved, farthest, inertial=way[frame], frame=frame, unit="m") if way.any() else ()
    return (
        *steps,
        *_beyond("turns", turned, widest, inertial=turn[frame], frame=frame, unit="rad"),
    )


def _told(covariances: Array) -> tuple[Array, BoolArray]:
    """Variances ``(T, 6)`` as estimated last up to each frame, 0 before the first, and whether at it."""
    variance = np.diagonal(covariances, axis1=1, axis2=2)
    told = np.asarray(np.isfinite(variance).all(axis=1))
    last = np.maximum.accumulate(np.where(told, np.arange(len(told)), -1))
    return np.where(last[:, None] >= 0, variance[last], 0.0), told


def _blind(run: Run, record: Record, inertial: Array) -> Array:
    """Inertial turn and distance ``(2, t)`` since the last fused observation, at each frame of a run.

    What the first observation after that corrects can be as much: dead reckoning is off by a share of them.
    """
    seen = np.zeros(inertial.shape[1], bool)
    seen[record.given.frame[run.used]] = True
    seen[0] = True
    last = np.maximum.accumulate(np.where(seen, np.arange(len(seen)), 0))
    total = np.cumsum(inertial, axis=1)
    return np.asarray((total - total[:, last])[:, run.frame])


def _beyond(
    what: str, values: Array, limit: Array, *, inertial: Array, frame: IntArray, unit: str
) -> tuple[str, ...]:
    """Line on the steps ``(n,)`` that are beyond their limits; none if none is."""
    beyond = values > limit
    if not beyond.any():
        return ()
    at = int(np.argmax(np.where(beyond, values, 0.0)))
    return (
        f"jumps: {np.count_nonzero(beyond)} {what} beyond what the inertial data allow, the largest "
        f"{values[at]:.3g} {unit} at frame {frame[at]}, where they have {inertial[at]:.3g} {unit}",
    )


def _fit(run: Run) -> tuple[str, ...]:
    """Residuals of the final estimate that have nothing to do with their stated noise."""
    if run.fit is None or run.fit[1] <= 0 or run.fit[0] <= _LARGEST_PER_FREEDOM * run.fit[1]:
        return ()
    return (f"does not fit its measurements: fit per degree of freedom {run.fit[0] / run.fit[1]:.2g}",)


def _innovations(run: Run) -> tuple[str, ...]:
    """Innovations that have nothing to do with their stated noise."""
    if run.nis_per_dof <= _LARGEST_PER_FREEDOM:
        return ()
    return (f"does not predict its measurements: NIS per degree of freedom {run.nis_per_dof:.2g}",)
