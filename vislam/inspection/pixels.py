"""Pixel noise: of one frame's step, its growth along a track, and the share that no rigid motion explains."""

import numpy as np
from scipy.optimize import nnls

from vislam.data.sequence import Sequence
from vislam.geometry import se3
from vislam.inspection.finding import Finding, Measured, robust_sigma
from vislam.types import Array
from vislam.vision import RigidFit, continuations

_SPANS = (1, 2, 4, 8)
_FEW, _MANY = 0.02, 0.15


def check_pixel_noise(
    sequence: Sequence, fits: dict[int, RigidFit], *, pixel_sigma_px: float, drift_px: float
) -> tuple[Finding, dict[str, Array]]:
    """White noise and drift from the row residuals of tracks over one and more frames.

    Rows, because columns hold the flow and with it the error of the depth.
    """
    sigmas = [
        robust_sigma(np.array(_row_residuals(sequence, fits, span)), name=f"span {span}", unit="px")
        for span in _SPANS
    ]
    variance = np.array([item.value**2 for item in sigmas])
    error = np.array([2.0 * item.value * max(item.sigma, 1e-4) for item in sigmas])
    known = np.isfinite(variance) & np.isfinite(error)
    series = {"pixel_span": np.array(_SPANS, float), "pixel_sigma": np.sqrt(variance)}
    if known.sum() < 2:
        return Finding("pixel noise", "unclear", "too few tracks over several frames"), series
    span = np.array(_SPANS, float)[known]
    columns = np.column_stack([np.ones(len(span)), span, span**2]) / error[known, None]
    draws = np.array(
        [nnls(columns, variance[known] / error[known] + noise)[0] for noise in _normal(len(span))]
    )
    # A step of the mean row has the variance of one pixel coordinate: two rows of half of it. The square of
    # the span is the error of the depth, which the row of a moving camera feels.
    white, drift = (_root(name, draws[:, part]) for part, name in enumerate(("pixel noise", "drift")))
    text = (
        f"{sigmas[0].value:.3f} px over one frame; {white}, {drift} a frame; "
        f"configured {pixel_sigma_px:g} and {drift_px:g} px"
    )
    return Finding("pixel noise", "note", text, (white, drift)), series


def check_moving(voted: Sequence, *, consensus: bool) -> Finding:
    """Share of steps that the rigid motion of their frame does not explain, counted by the consensus cut."""
    cuts = voted.counts["inconsistent_cuts"]
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
        moved[:, 2] = np.maximum(moved[:, 2], 0.5)
        residual = (z[new] - sequence.rig.project(moved))[:, 2]
        # What all share is the error of the chained motion, not of the tracks.
        out += (residual - np.median(residual)).tolist()
    return out


def _normal(size: int) -> Array:
    """Draws ``(200, size)``, the first of them zero: the fit itself, then its spread."""
    draws = np.random.default_rng(0).standard_normal((200, size))
    draws[0] = 0.0
    return draws


def _root(name: str, variances: Array) -> Measured:
    low, high = np.sqrt(np.quantile(variances, [0.025, 0.975]))
    return Measured(name, "px", float(np.sqrt(variances[0])), float(low), float(high))
