"""A trajectory from elsewhere matched with its reference: what it is scored by, and what is noticed of it."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.own_clock import OwnClock
from vislam.core.reference import Reference
from vislam.core.run import Cost, Innovations, Log, Run
from vislam.core.stamped import Stamped
from vislam.core.trajectory import Poses
from vislam.evaluation.alignment import align
from vislam.evaluation.clock import estimate_offset
from vislam.evaluation.conventions import noticed
from vislam.evaluation.covariance_conventions import Covariances
from vislam.evaluation.matching import Matching, Paired, match
from vislam.geometry import se3

_REACH = 1.0
"""Farthest clock offset that is searched for [s]."""
_SCORED = 3
"""Pairs without which nothing is scored."""
_STILL = 1e-9
"""Attitudes that differ by less are all the same."""


@dataclass(frozen=True)
class Elsewhere:
    """A trajectory from elsewhere, of the body of the reference's world or another.

    Attributes
    ----------
    name : str
    stamped : Stamped
        Its poses are those of the body; without covariances.
    covariances : Covariances or None
    clock_offset : float or "estimate"
        What has been added to its stamps [s], or what is to be found.
    alignment : "se3" or "sim3"
    points : (m, 3) or None
        Of its map [m].
    told : tuple of str
        How it was read.
    counts : dict
        What was mended, and left out.
    """

    name: str
    stamped: Stamped
    covariances: Covariances | None = None
    clock_offset: float | Literal["estimate"] = 0.0
    alignment: Literal["se3", "sim3"] = "se3"
    points: Array | None = None
    told: tuple[str, ...] = ()
    counts: dict[str, int] | None = None


class Unmatched(ValueError):
    """A trajectory with nothing in common with the reference; the message says what there is."""


def on_own_clock(given: Elsewhere, reference: Reference, source: Stamped, settings: Matching) -> OwnClock:
    """Match a trajectory with a reference, on the stamps of both.

    Parameters
    ----------
    given : Elsewhere
    reference : Reference
        Its name, its point and its uncertainty.
    source : Stamped
        Its rows.
    settings : Matching

    Raises
    ------
    Unmatched
        If fewer than three rows belong together.
    """
    own, told = given.stamped, list(given.told)
    facts: dict[str, float] = {}
    if given.clock_offset == "estimate":
        offset = estimate_offset(own, source, reach=_REACH, scaled=True)
        if offset is None:
            raise Unmatched("clock_offset: estimate: too little in common, or it moves too little to tell")
        own = own.shifted(offset.value)
        told.append(f"clock offset estimated, {offset}")
        facts |= {
            "clock_offset": offset.value,
            "clock_offset_low": offset.low,
            "clock_offset_high": offset.high,
        }
    pairs = match(own, source, settings)
    if len(pairs) < _SCORED:
        raise Unmatched(_nothing(given, own, source, settings, pairs))
    told.append(f"{len(pairs)} rows matched, {pairs.how}")
    scale = 1.0
    if given.alignment == "sim3":
        scale = _scale(pairs)
        told.append(f"positions scaled by {scale:.6g} to fit (alignment: sim3)")
        facts["scale"] = scale
        own, pairs = _scaled(own, scale), replace(pairs, estimate=_scaled(pairs.estimate, scale))
    facts |= {
        "rows_matched": float(len(pairs)),
        "share_matched": pairs.share,
        "completion": _completion(pairs, source, settings),
    }
    turning = _turns(own.pose) and (source.pose is None or _turns(source.pose))
    rows = replace(pairs.estimate, cov=None)
    low, high = source.stamp[0] + settings.start, source.stamp[0] + settings.end
    inside = own.take((own.stamp >= low) & (own.stamp <= high))
    run_rows = rows if pairs.interpolated == "estimate" else inside
    index = _index(run_rows, pairs)
    matched = Reference(
        name=reference.name,
        limits=reference.limits,
        frame=index,
        position=pairs.reference.position,
        pose=pairs.reference.pose if turning else None,
        imu_T_point=reference.imu_T_point,
        sigma=reference.sigma,
        sigma_rotation=reference.sigma_rotation,
    )
    cov = None
    if given.covariances is not None:
        every, said = given.covariances.chosen(pairs.estimate.stamp, own.stamp, matched.pose, scale=scale)
        told += said
        cov = _at_rows(own.stamp, every, run_rows.stamp)
    run = as_run(given, run_rows, cov, frame=np.arange(len(run_rows), dtype=np.int64))
    return OwnClock(
        run=run,
        reference=matched,
        timed=own.timed,
        facts=facts,
        points=None if given.points is None else scale * given.points,
        told=tuple(told),
        noticed=noticed(pairs, source, own, reference=reference, scaled=given.alignment == "sim3"),
    )


def as_run(given: Elsewhere, rows: Stamped, cov: Array | None, *, frame: IntArray) -> Run:
    """Run that knows poses, and nothing of how they came about."""
    return Run(
        name=given.name,
        frames_expected=len(rows),
        frame=frame,
        stamp=rows.stamp,
        filtered=Poses(rows.poses, cov),
        innovations=Innovations.unknown(len(rows)),
        used=np.zeros(0, bool),
        gated=np.zeros(0, bool),
        cost=Cost(total_time=float("nan")),
        log=Log(counts=dict(given.counts or {})),
        elsewhere=True,
    )


def _index(own: Stamped, pairs: Paired) -> IntArray:
    """Rows of the whole trajectory that were matched."""
    return np.asarray(np.searchsorted(own.stamp, pairs.estimate.stamp), np.int64)


def _at_rows(stamp: Array, cov: Array, at: Array) -> Array:
    """Covariances at other times, linearly between those around them."""
    if len(at) == len(stamp) and np.array_equal(at, stamp):
        return cov
    own = Stamped(stamp, np.zeros((len(stamp), 3)), cov=cov)
    found = own.interpolated(at).cov
    assert found is not None
    return found


def _scale(pairs: Paired) -> float:
    """Scale of the similarity that fits best, Umeyama (PAMI 1991), eq. (42)."""
    target = pairs.reference.position
    own = pairs.estimate.position[:, : target.shape[1]]
    rotation, _ = align(own, target)
    turned, wanted = (own - own[0]) @ rotation.T, target - target[0]
    turned, wanted = turned - turned.mean(axis=0), wanted - wanted.mean(axis=0)
    square = float(np.sum(turned**2))
    return float(np.sum(turned * wanted)) / square if square > 0.0 else 1.0


def _scaled(own: Stamped, scale: float) -> Stamped:
    pose = own.pose
    if pose is not None:
        pose = se3.from_rotation_translation(pose[:, :3, :3], scale * own.position)
    return replace(own, position=scale * own.position, pose=pose)


def _turns(pose: Array | None) -> bool:
    """Whether there are attitudes, and not one for all."""
    return pose is not None and bool(np.abs(pose[:, :3, :3] - pose[0, :3, :3]).max() > _STILL)


def _completion(pairs: Paired, source: Stamped, settings: Matching) -> float:
    """Share of the reference's time from the first matched row to the last [%]."""
    start = source.stamp[0] + settings.start
    end = min(source.stamp[-1], source.stamp[0] + settings.end)
    covered = pairs.reference.stamp[-1] - pairs.reference.stamp[0]
    return float(100.0 * covered / (end - start)) if end > start else 100.0


def _nothing(given: Elsewhere, own: Stamped, source: Stamped, settings: Matching, pairs: Paired) -> str:
    """Say why nothing could be matched, and what would help."""
    said = (
        f"{len(pairs)} of its {pairs.estimate_rows} rows belong to one of the {pairs.reference_rows} of "
        f"{'the reference'}"
    )
    if not own.timed:
        return f"{said} by their frames; are they of the same sequence? frames=FILE names them"
    units = "".join(f"{text}; " for text in given.told if "look like" in text)
    spans = (
        f"{units}stamps {own.stamp[0]:.3f} to {own.stamp[-1]:.3f} s, "
        f"the reference's {source.stamp[0]:.3f} to {source.stamp[-1]:.3f} s"
    )
    found = estimate_offset(own, source, reach=_REACH, scaled=True)
    if found is not None and np.isfinite(found.after):
        return f"{said}: {spans}; they fit with clock_offset={found.value:.4f} (or clock_offset=estimate)"
    unit = next((u for u, f in (("ms", 1e3), ("us", 1e6), ("ns", 1e9)) if _overlap(own, source, f)), None)
    if unit is not None:
        return f"{said}: {spans}; they would overlap with unit={unit}"
    return f"{said}: {spans}; give unit= or clock_offset=, or a file of the same sequence"


def _overlap(own: Stamped, source: Stamped, factor: float) -> bool:
    low, high = own.stamp[0] / factor, own.stamp[-1] / factor
    return bool(low < source.stamp[-1] and high > source.stamp[0])
