"""Pixel noise: of one frame's step, its growth along a track, and the share that no rigid motion explains."""

import itertools
from dataclasses import dataclass

import numpy as np

from vislam.base.resampling import jackknife
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.rigid_fit import RigidFit, continuations
from vislam.core.sequence import Sequence
from vislam.geometry import se3
from vislam.inspection.finding import Finding, Measured, robust_sigma

_SPANS = (1, 2, 4, 8)
_FEW, _MANY = 0.02, 0.15
_FEWEST = 100
_BLOCKS = 12
_GATE, _GATINGS = 4.0, 20
_SMALLEST_PX = 0.02
"""No tracker is better; a noise of zero would be believed without end."""


def check_pixel_noise(
    sequence: Sequence, fits: dict[int, RigidFit], *, pixel_sigma_px: float, drift_px: float
) -> tuple[Finding, dict[str, Array]]:
    """White noise and drift from the row residuals of tracks from frame to frame.

    Rows, because columns hold the flow and with it the error of the depth. Residuals r of successive steps of
    a track share an observation, whose white noise enters both with opposite signs; what they and steps that
    share none have in common is the error of the depth:

        cov(r_k, r_{k+1}) = c - w^2 / 2,   cov(r_k, r_{k+2}) = c,   var(r_k) = w^2 + d^2 + c.

    A step of the mean row has the variance of one pixel coordinate: two rows of half of it.
    """
    spans = [
        robust_sigma(np.array(_row_residuals(sequence, fits, span)), name=f"span {span}", unit="px")
        for span in _SPANS
    ]
    series = {"pixel_span": np.array(_SPANS, float), "pixel_sigma": np.array([item.value for item in spans])}
    steps = _steps_of_tracks(sequence, fits)
    if len(steps.residual) < _FEWEST or len(steps.apart[2]) < _FEWEST:
        text = f"{len(steps.residual)} steps of tracks, too few"
        unknown = {f"noise.{name}": f"{text}; as configured" for name in ("pixel_sigma_px", "drift_px")}
        return Finding("pixel noise", "unclear", text, unknown=unknown), series
    edges = np.linspace(0, len(sequence), _BLOCKS + 1)
    whole = _levels(steps, np.ones(len(sequence), bool))
    left_out = []
    for low, high in itertools.pairwise(edges):
        frame = np.arange(len(sequence))
        left_out.append(_levels(steps, (frame < low) | (frame >= high)))
    error = np.nan_to_num(jackknife(np.array(left_out)), nan=np.inf)
    white, drift = (
        _root(name, float(value), float(one))
        for name, value, one in zip(("pixel noise", "drift"), whole, error, strict=True)
    )
    kept = _within_gate(steps.residual)
    text = (
        f"{spans[0].value:.3f} px over one frame, {kept:.3f} px with the tails that a gate keeps; {white}, "
        f"{drift} a frame; configured {pixel_sigma_px:g} and {drift_px:g} px"
    )
    settings, unknown = _noise_settings(kept, white)
    return Finding("pixel noise", "note", text, (white, drift), settings=settings, unknown=unknown), series


def _noise_settings(step_px: float, white: Measured) -> tuple[dict[str, float], dict[str, str]]:
    """Noise levels for the config, and those that could not be determined.

    Their sum is the whole of what a step is off by, tails that a gate keeps included: an estimator that takes
    the noise for Gaussian needs that. Where the white noise does not show, half of the variance is taken for
    it, lest single pixels be believed too much.
    """
    step_px = max(step_px, np.sqrt(2.0) * _SMALLEST_PX)
    level, unknown = min(white.value, step_px), {}
    if white.low < _SMALLEST_PX:
        level = step_px / np.sqrt(2.0)
        unknown["noise.pixel_sigma_px"] = (
            f"how the {step_px:.3g} px of a step divide into white noise and drift; half each"
        )
    walk = float(np.sqrt(step_px**2 - level**2))
    return {"noise.pixel_sigma_px": round(float(level), 4), "noise.drift_px": round(walk, 4)}, unknown


@dataclass(frozen=True)
class _Steps:
    """Row residuals of tracks from frame to frame.

    Attributes
    ----------
    frame, residual : (m,)
        Frame in which the step ends, and residual [px].
    apart : dict of int to (p, 2)
        Rows of two steps of one track that lie one and two frames apart.
    """

    frame: IntArray
    residual: Array
    apart: dict[int, IntArray]


def _steps_of_tracks(sequence: Sequence, fits: dict[int, RigidFit]) -> _Steps:
    pairs = continuations(sequence)
    z, points = sequence.z, sequence.rig.back_project(sequence.z)
    frames, tracks, residuals = [np.empty(0, np.int64)], [np.empty(0, np.int64)], [np.empty(0)]
    for k, fit in fits.items():
        rows = slice(pairs.start[k], pairs.start[k + 1])
        moved = se3.transform(fit.next_T_prev, points[pairs.before[rows]])
        moved[:, 2] = np.maximum(moved[:, 2], sequence.rig.nearest)
        residual = (z[pairs.after[rows]] - sequence.rig.project(moved))[:, 2]
        frames.append(np.full(len(residual), k))
        tracks.append(sequence.track[pairs.after[rows]])
        # What all share is the error of the motion, not of the tracks.
        residuals.append(residual - np.median(residual))
    frame, track, residual = np.concatenate(frames), np.concatenate(tracks), np.concatenate(residuals)
    key = track * (2 * len(sequence)) + frame
    order = np.argsort(key)
    key, frame, residual = key[order], frame[order], residual[order]
    apart = {}
    for lag in (1, 2):
        at = np.minimum(np.searchsorted(key, key + lag), max(len(key) - 1, 0))
        first = np.flatnonzero(key[at] == key + lag)
        apart[lag] = np.column_stack([first, at[first]])
    return _Steps(frame, residual, apart)


def _levels(steps: _Steps, kept: BoolArray) -> Array:
    """Variances ``(2,)`` of white noise and of a step of the drift; of the steps that end in kept frames."""
    covariance = {}
    for lag, pair in steps.apart.items():
        one, other = steps.residual[pair[kept[steps.frame[pair[:, 0]]]]].T
        covariance[lag] = 0.25 * (_mad(one + other) ** 2 - _mad(one - other) ** 2)
    white = 2.0 * (covariance[2] - covariance[1])
    drift = _mad(steps.residual[kept[steps.frame]]) ** 2 - max(white, 0.0) - max(covariance[2], 0.0)
    return np.array([white, drift])


def _mad(values: Array) -> float:
    """Robust standard deviation; NaN of none."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values)))) if len(values) else float("nan")


def _within_gate(values: Array) -> float:
    """Standard deviation of what a gate of so many of it keeps: the core and the tails that pass."""
    sigma = _mad(values)
    for _ in range(_GATINGS):
        inside = values[np.abs(values) <= _GATE * sigma]
        sigma = float(np.sqrt(np.mean(inside**2))) if len(inside) else sigma
    return sigma


def check_moving(voted: Sequence, *, consensus: bool) -> Finding:
    """Share of steps that the rigid motion of their frame does not explain, counted by the consensus cut."""
    cuts = voted.counts["inconsistent_cuts"] + voted.counts["inconsistent_cuts_few_tracks"]
    steps = len(continuations(voted).before) + cuts
    share = cuts / max(steps, 1)
    counts = {"share": share, "steps": steps}
    text = (
        f"{100 * share:.1f} % of {steps} steps do not follow the rigid motion of the rest: "
        "vehicles, wrong matches, slips"
    )
    if share < _FEW:
        return Finding("moving objects", "ok", text, counts=counts)
    if consensus:
        text = f"{text}; the configured consensus cut answers it"
        return Finding("moving objects", "note" if share > _MANY else "ok", text, counts=counts)
    return Finding("moving objects", "fault", text, counts=counts, proposal={"data.repair.consensus": True})


def _row_residuals(sequence: Sequence, fits: dict[int, RigidFit], span: int) -> list[float]:
    """Row residuals [px] of tracks against their observation ``span`` frames before, by the chained fits."""
    z, frame, track = sequence.z, sequence.frame_of, sequence.track
    tracks = int(track.max(initial=0)) + 1
    key = frame * tracks + track
    order = np.argsort(key)
    key = key[order]
    out: list[float] = []
    for k in range(span, len(sequence), max(1, span // 2)):
        if any(j not in fits for j in range(k - span + 1, k + 1)):
            continue
        motion = np.eye(4)
        for j in range(k - span + 1, k + 1):
            motion = fits[j].next_T_prev @ motion
        now = np.arange(sequence.offset[k], sequence.offset[k + 1])
        wanted = (k - span) * tracks + track[now]
        at = np.clip(np.searchsorted(key, wanted), 0, len(order) - 1)
        there = key[at] == wanted
        old, new = order[at[there]], now[there]
        if len(old) < 6:
            continue
        moved = se3.transform(motion, sequence.rig.back_project(z[old]))
        moved[:, 2] = np.maximum(moved[:, 2], sequence.rig.nearest)
        residual = (z[new] - sequence.rig.project(moved))[:, 2]
        # What all share is the error of the chained motion, not of the tracks.
        out += (residual - np.median(residual)).tolist()
    return out


def _root(name: str, variance: float, error: float) -> Measured:
    """Standard deviation of a variance that may come out below zero, with its interval."""
    value, low, high = np.sqrt(np.maximum([variance, variance - 1.96 * error, variance + 1.96 * error], 0.0))
    return Measured(name, "px", float(value), float(low), float(high))
