"""Disparity and scale: the camera's way against the inertial one, track by track, near and far.

Between two frames each track tells, by its flow and its depth, how far the camera went. A wrong baseline
makes that wrong by one factor for all; an offset o of the disparities d makes it ``1 - o / d``, wrong for the
far ones.
"""

import itertools
from dataclasses import dataclass

import numpy as np

from vislam.base.resampling import jackknife
from vislam.base.types import Array, IntArray
from vislam.core.rigid_fit import Continuations, RigidFit, continuations, predicted_steps, rigid_fits
from vislam.core.sequence import Sequence
from vislam.inspection.finding import Finding, Measured
from vislam.repair import RepairConfig
from vislam.repair.pixels import DisparityOffset

_SHORTEST = 0.012
"""A step below this share of the depth of its tracks says nothing about scale."""
_SMALLEST_FLOW_PX = 2.0
_EDGES_PX = np.array([3.0, 4.5, 6.5, 9.0, 12.0, 16.0, 22.0, 30.0, 45.0, 80.0, 140.0, 250.0, 450.0])
"""Bins of disparity, up to that of what is an arm's length away. Below them the gate at which a track may
start chooses what the noise made near."""
_FEWEST = 40
_BLOCKS = 12
_OUTLIER = 6.0
_SCALE_UNCLEAR = 0.05
_OFFSET_UNCLEAR_PX = 1.0
"""Standard deviations above which nothing is said of scale and offset."""
_SCALE_FAULT = 0.006
_SCALE_UNIT = 1.5
"""A scale that is off by more than this factor is no error of the calibration."""
_MATCH_LAGS, _MATCH_DISPARITY_PX, _MATCH_FEWEST = (2, 3), 10.0, 200
"""Steps of a track that share no observation, and tracks near enough for the error to be small."""
_SHORTEST_SEEN = 0.05
"""A seen step must be so long, in baselines, to tell a depth."""
_OFFSET_FAULT_PX = 0.1
_TRIALS, _RESTS_PX, _LARGEST_MOVE_PX = 3, 0.05, 1.0
_SMALLEST_DISPARITY_PX = 0.5
_FLOOR = np.array([0.001, 0.03])
"""What the choice of tracks moves the scale and the offset [px] by, whatever their intervals say."""


@dataclass(frozen=True)
class Ways:
    """Path length of a step by each continuing track.

    Attributes
    ----------
    frame, row : (m,)
        Where the step ends, and the observation at which it starts.
    disparity : (m,)
        Measured at the start of the step [px].
    ratio : (m,)
        Way by the track over that of the step.
    """

    frame: IntArray
    row: IntArray
    disparity: Array
    ratio: Array


def inertial_ways(sequence: Sequence, pairs: Continuations, fits: dict[int, RigidFit]) -> Ways:
    """Ratios of all tracks whose flow tells one to the inertial way."""
    predicted = predicted_steps(sequence)
    points = sequence.rig.back_project(sequence.z)
    steps = {}
    for k, fit in fits.items():
        direction = fit.next_T_prev[:3, 3] / max(float(np.linalg.norm(fit.next_T_prev[:3, 3])), 1e-9)
        # Only what of the inertial step lies along the seen one: noise across it would lengthen it.
        step = float(predicted[k][:3, 3] @ direction) * direction
        depth = float(np.median(points[pairs.before[pairs.start[k] : pairs.start[k + 1]], 2]))
        if np.linalg.norm(step) >= _SHORTEST * depth:
            steps[k] = step
    return _ways(sequence, pairs, fits, steps)


def _ways(
    sequence: Sequence, pairs: Continuations, fits: dict[int, RigidFit], steps: dict[int, Array]
) -> Ways:
    """Ratios to the given steps ``(3,)`` of the camera; turn and direction are those of the robust fit."""
    z, rig = sequence.z, sequence.rig
    points = rig.back_project(z)
    rows, table = [np.empty((0, 2), np.int64)], [np.empty((0, 2))]
    for k, step in steps.items():
        fit = fits[k]
        good = np.linalg.norm(fit.residual, axis=1) < _OUTLIER
        before = pairs.before[pairs.start[k] : pairs.start[k + 1]][good]
        after = pairs.after[pairs.start[k] : pairs.start[k + 1]][good]
        turned = points[before] @ fit.next_T_prev[:3, :3].T
        ratio = np.ones(len(before))
        for _ in range(4):
            moved = turned + ratio[:, None] * step
            moved[:, 2] = np.maximum(moved[:, 2], rig.nearest)
            flow = (rig.projection_jacobian(moved) @ step)[:, [0, 2]]
            residual = (z[after] - rig.project(moved))[:, [0, 2]]
            square = np.maximum((flow**2).sum(axis=1), 1e-9)
            ratio = ratio + np.clip((flow * residual).sum(axis=1) / square, -0.5, 0.5)
        tells = np.sqrt(square) > _SMALLEST_FLOW_PX
        rows.append(np.column_stack([np.full(len(before), k), before])[tells])
        table.append(np.column_stack([z[before, 0] - z[before, 1], ratio])[tells])
    row, value = np.concatenate(rows), np.concatenate(table)
    return Ways(row[:, 0], row[:, 1], value[:, 0], value[:, 1])


def check_stereo(sequence: Sequence, repair: RepairConfig) -> tuple[list[Finding], dict[str, Array]]:
    """Baseline and disparity offset at which near and far tracks agree with the inertial way.

    Part of an offset hides in the turn and direction of the fits, so what is left of it is taken out and the
    fits are made again, until nothing is left: by secants.
    """
    first = _told(sequence, 0.0)
    if first is None:
        text = "too few tracks with flow and depth to determine scale and offset"
        checks = {"stereo scale": "baseline", "disparity offset": "disparity_offset"}
        return [
            Finding(check, "unclear", text, unknown={f"data.repair.{step}": text})
            for check, step in checks.items()
        ], {}
    told, offset, gain = first, 0.0, 0.5
    for _ in range(_TRIALS):
        if abs(told.left[1]) < _RESTS_PX:
            break
        move = float(np.clip(told.left[1] / gain, -_LARGEST_MOVE_PX, _LARGEST_MOVE_PX))
        moved = _told(sequence, offset + move)
        if moved is None:
            break
        gain = float(np.clip((told.left[1] - moved.left[1]) / move, 0.2, 1.2))
        told, offset = moved, offset + move
    offset += told.left[1] / gain
    scale, error = told.left[0], told.error / np.array([1.0, gain])
    measured = [
        Measured.around(name, unit, float(value), sigma=float(one))
        for name, unit, value, one in zip(
            ("camera's way over inertial way", "disparity offset"),
            ("", "px"),
            (scale, offset),
            np.hypot(error, _FLOOR),
            strict=True,
        )
    ]
    series = {"way_disparity": first.centres, "way_ratio": first.medians}
    return [_scale_finding(sequence, measured[0]), _offset_finding(measured[1], repair)], series


@dataclass(frozen=True)
class _Told:
    """Scale and offset that are left, their jackknife errors, and the medians they come from."""

    left: Array
    error: Array
    centres: Array
    medians: Array


def _told(sequence: Sequence, offset: float) -> _Told | None:
    """Scale and offset by the tracks, less an offset of the disparities; None if they are too few."""
    moved = DisparityOffset(pixels=offset).apply(sequence)
    moved = moved.select(moved.disparity > _SMALLEST_DISPARITY_PX)
    pairs = continuations(moved)
    seen = inertial_ways(moved, pairs, rigid_fits(moved, pairs))
    whole, centres, medians = _fit(seen.disparity, seen.ratio)
    if whole is None:
        return None
    edges = np.quantile(seen.frame, np.linspace(0.0, 1.0, _BLOCKS + 1))
    parts = np.clip(np.searchsorted(edges, seen.frame, side="right") - 1, 0, _BLOCKS - 1)
    fits = [_fit(seen.disparity[parts != part], seen.ratio[parts != part])[0] for part in range(_BLOCKS)]
    left_out = np.array([fit for fit in fits if fit is not None])
    return _Told(whole, jackknife(left_out), centres, medians)


def _scale_finding(sequence: Sequence, scale: Measured) -> Finding:
    baseline = sequence.rig.baseline
    if not 1.0 / _SCALE_UNIT < scale.value < _SCALE_UNIT or scale.low <= 0.0:
        text = f"{scale} for near tracks: no calibration error, see units; no baseline is proposed"
        return Finding("stereo scale", "fault", text, (scale,), unknown={"data.repair.baseline": text})
    fitting = Measured("baseline", "m", baseline / scale.value, baseline / scale.high, baseline / scale.low)
    text = f"{scale} for near tracks; they would agree with {fitting}, the rig has {baseline:.5f} m"
    off = abs(scale.value - 1.0)
    if scale.sigma > _SCALE_UNCLEAR:
        text = f"the sequence does not determine the scale: {text}"
        return Finding(
            "stereo scale", "unclear", text, (scale, fitting), unknown={"data.repair.baseline": text}
        )
    if off <= _SCALE_FAULT or off <= 3.0 * scale.sigma:
        return Finding("stereo scale", "ok", text, (scale, fitting))
    text = f"the camera's way is {100 * (scale.value - 1):+.1f} % off: {text}; look up the calibration"
    if off <= 4.0 * scale.sigma:
        return Finding(
            "stereo scale", "unclear", text, (scale, fitting), unknown={"data.repair.baseline": text}
        )
    proposal = {"data.repair.baseline": {"metres": float(f"{fitting.value:.4g}")}}
    return Finding("stereo scale", "fault", text, (scale, fitting), proposal=proposal)


def _offset_finding(offset: Measured, repair: RepairConfig) -> Finding:
    if offset.sigma > _OFFSET_UNCLEAR_PX:
        text = f"the sequence does not determine the offset: {offset}"
        unknown = {"data.repair.disparity_offset": text}
        return Finding("disparity offset", "unclear", text, (offset,), unknown=unknown)
    applied = 0.0 if repair.disparity_offset is None else repair.disparity_offset.pixels
    if abs(offset.value) > _OFFSET_FAULT_PX and abs(offset.value) > 4.0 * offset.sigma:
        side = "large" if offset.value > 0 else "small"
        where = "near" if offset.value > 0 else "far"
        text = f"disparities are too {side}, far points come out too {where}: {offset}"
        proposal = {"data.repair.disparity_offset": {"pixels": round(applied + offset.value, 2)}}
        return Finding("disparity offset", "fault", text, (offset,), proposal=proposal)
    return Finding("disparity offset", "ok", str(offset), (offset,))


def _fit(disparity: Array, ratio: Array) -> tuple[Array | None, Array, Array]:
    """Scale and offset from the medians of disparity bins, and these medians."""
    rows = []
    for low, high in itertools.pairwise(_EDGES_PX):
        inside = (disparity >= low) & (disparity < high)
        count = int(np.count_nonzero(inside))
        if count < _FEWEST:
            continue
        middle = float(np.median(ratio[inside]))
        spread = 1.4826 * float(np.median(np.abs(ratio[inside] - middle)))
        rows.append([float(np.median(disparity[inside])), middle, spread / np.sqrt(count)])
    table = np.array(rows).reshape(-1, 3)
    if len(table) < 3:
        return None, table[:, 0], table[:, 1]
    # A floor keeps a bin of thousands from deciding alone: its systematic error does not fall with its size.
    weight = 1.0 / np.hypot(table[:, 2], 0.003)
    columns = np.column_stack([np.ones(len(table)), -1.0 / table[:, 0]])
    solution = np.linalg.lstsq(columns * weight[:, None], table[:, 1] * weight, rcond=None)[0]
    return np.array([solution[0], solution[1] / solution[0]]), table[:, 0], table[:, 1]


def check_match(sequence: Sequence, fits: dict[int, RigidFit], *, matching_bias_px: float) -> Finding:
    """Stereo-matching bias: what of a track's depth error stays with it.

    By its disparity and flow, every track says how far the camera went. Ratios to the seen step in steps that
    share no observation have in common the bias e of the track's first disparity d alone: their covariance is
    that of e. Inertial data do not enter.
    """
    pairs = continuations(sequence)
    shortest = _SHORTEST_SEEN * sequence.rig.baseline
    steps = {k: fit.next_T_prev[:3, 3] for k, fit in fits.items()}
    steps = {k: step for k, step in steps.items() if np.linalg.norm(step) > shortest}
    seen = _ways(sequence, pairs, fits, steps)
    first = sequence.disparity[sequence.first_rows()][seen.row]
    near = first >= _MATCH_DISPARITY_PX
    track, frame = sequence.track[seen.row][near], seen.frame[near]
    error = (seen.ratio[near] - 1.0) * first[near]
    one, other = _lagged(track, frame, error, len(sequence))
    if len(one) < _MATCH_FEWEST:
        text = f"{len(one)} pairs of steps of near tracks, too few to determine the stereo-matching bias"
        unknown = {"noise.matching_bias_px": f"{text}; {matching_bias_px:g} px as configured"}
        return Finding("stereo match", "unclear", text, unknown=unknown)
    parts = [part for part in np.array_split(np.arange(len(one)), _BLOCKS) if len(part)]
    whole = _common(one, other)
    left_out = [_common(np.delete(one, part), np.delete(other, part)) for part in parts]
    sigma = float(np.hypot(jackknife(np.array(left_out)), 0.05 * whole))
    measured = Measured.around("stereo-matching bias", "px", whole, sigma=sigma)
    text = f"{measured} at the first disparity of a track; configured {matching_bias_px:g} px"
    if measured.low <= 0.0:
        unknown = {"noise.matching_bias_px": f"{text}: not told from none, as configured"}
        return Finding("stereo match", "unclear", text, (measured,), unknown=unknown)
    settings = {"noise.matching_bias_px": round(whole, 3)}
    return Finding("stereo match", "note", text, (measured,), settings=settings)


def _lagged(track: IntArray, frame: IntArray, error: Array, frames: int) -> tuple[Array, Array]:
    """Errors of one track in two steps that share no observation, ``(m,)`` each, in the order of time."""
    key = track * (2 * frames) + frame
    order = np.argsort(key)
    key, value = key[order], error[order]
    ones, others, times = [], [], []
    for lag in _MATCH_LAGS:
        at = np.searchsorted(key, key + lag)
        there = np.flatnonzero(at < len(key))
        there = there[key[at[there]] == key[there] + lag]
        ones.append(value[there])
        others.append(value[at[there]])
        times.append(frame[order][there])
    by_time = np.argsort(np.concatenate(times), kind="stable")
    return np.concatenate(ones)[by_time], np.concatenate(others)[by_time]


def _common(one: Array, other: Array) -> float:
    """Standard deviation of what two series have in common, by robust variances of sum and difference."""
    total, difference = (
        1.4826 * float(np.median(np.abs(item - np.median(item)))) for item in (one + other, one - other)
    )
    return 0.5 * float(np.sqrt(max(total**2 - difference**2, 0.0)))
