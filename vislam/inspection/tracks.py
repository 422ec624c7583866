"""Tracks and stamps: stale frames, repeats, gaps, and what cannot be a stereo observation."""

import numpy as np

from vislam.data.sequence import Sequence
from vislam.inspection.finding import Finding
from vislam.repair import RepairConfig
from vislam.repair.tracks import stale_observations
from vislam.types import Array

_FEW = 10
"""A frame with fewer tracks says little about its motion."""
_GAP = 1.5
"""A step this many times the usual one misses a frame."""
_ROWS_DIFFER_PX = 2.0
_LISTED = 12


def check_stale(sequence: Sequence, repair: RepairConfig) -> tuple[Finding, dict[str, Array]]:
    """Frames in which most tracks repeat the pixels of the frame before, bit for bit."""
    stale, repeats = stale_observations(sequence)
    frames = np.flatnonzero(stale)
    in_stale = int(repeats[stale[sequence.frame_of]].sum())
    lone = int(repeats.sum()) - in_stale
    share = len(frames) / max(len(sequence) - 1, 1)
    counts = {"stale_frames": len(frames), "observations": in_stale, "lone_repeats": lone, "share": share}
    series = {"stale_frames": frames.astype(float)}
    if len(frames) == 0:
        return Finding("stale tracks", "ok", f"no stale frame; {lone} lone repeats", counts=counts), series
    listed = ", ".join(str(k) for k in frames[:_LISTED]) + (" ..." if len(frames) > _LISTED else "")
    text = (
        f"{len(frames)} frames ({listed}) repeat the pixels of the frame before in {in_stale} observations, "
        "then follow other points; taken as they stand they say 'no motion' and shorten the path by "
        f"{100 * share:.0f} %; {lone} lone repeats besides"
    )
    if repair.stale_tracks is not None:
        return Finding("stale tracks", "ok", f"{text}; the configured cut answers it", counts=counts), series
    proposal = {"data.repair.stale_tracks": True}
    return Finding("stale tracks", "fault", text, counts=counts, proposal=proposal), series


def check_stamps(sequence: Sequence) -> Finding:
    """Steps of the camera and inertial stamps; the reader has refused what does not increase."""
    step = np.diff(sequence.stamp)
    usual = float(np.median(step))
    gaps = np.flatnonzero(step > _GAP * usual)
    missing = int(np.round(step[gaps] / usual - 1.0).sum())
    inertial = np.diff(sequence.inertial_stamp)
    inertial_gaps = int(np.sum(inertial > 2.0 * max(usual, float(np.median(inertial)))))
    counts = {
        "period_s": usual,
        "gaps": len(gaps),
        "frames_missing": missing,
        "longest_step_s": float(step.max()),
        "inertial_gaps": inertial_gaps,
    }
    if len(gaps) + inertial_gaps == 0:
        text = f"{len(sequence)} frames every {usual:.4f} s, no gap"
        return Finding("stamps", "ok", text, counts=counts)
    listed = ", ".join(str(k + 1) for k in gaps[:_LISTED])
    text = (
        f"{len(gaps)} gaps (before frames {listed}), {missing} frames missing, longest step "
        f"{step.max():.3f} s, {inertial_gaps} gaps in the inertial samples: nothing spans them"
    )
    return Finding("stamps", "note", text, counts=counts)


def check_observations(sequence: Sequence, repair: RepairConfig) -> Finding:
    """Disparities, rows and columns that cannot be, as the file has them."""
    pixels = sequence.pixels
    total = max(len(pixels), 1)
    disparity = sequence.disparity
    rows = np.abs(pixels[:, 1] - pixels[:, 3])
    width, height = 2.0 * sequence.rig.cx, 2.0 * sequence.rig.cy
    outside = (pixels[:, [0, 2]] < 0).any(axis=1) | (pixels[:, [0, 2]] > 1.2 * width).any(axis=1)
    outside |= (pixels[:, [1, 3]] < 0).any(axis=1) | (pixels[:, [1, 3]] > 1.6 * height).any(axis=1)
    counts = {
        "disparity_not_positive": int(np.sum(disparity <= 0)),
        "lowest_disparity_px": float(disparity.min(initial=0.0)),
        "rows_differ": int(np.sum(rows > _ROWS_DIFFER_PX)),
        "row_difference_median_px": float(np.median(rows)) if len(rows) else 0.0,
        "outside_image": int(outside.sum()),
    }
    text = (
        f"{counts['disparity_not_positive']} of {len(pixels)} observations have a disparity of zero or less "
        f"(lowest {counts['lowest_disparity_px']:.1f} px), {counts['rows_differ']} rows differ by more than "
        f"{_ROWS_DIFFER_PX:g} px, {counts['outside_image']} lie outside an image of twice the principal point"
    )
    bad = counts["disparity_not_positive"] + counts["rows_differ"]
    if bad == 0:
        return Finding("observations", "ok", text, counts=counts)
    if repair.disparity is not None:
        share = 100.0 * bad / total
        text = f"{text}; the configured disparity step drops them ({share:.1f} %)"
        return Finding("observations", "ok", text, counts=counts)
    return Finding("observations", "fault", text, counts=counts, proposal={"data.repair.disparity": True})


def check_track_counts(sequence: Sequence) -> tuple[Finding, dict[str, Array]]:
    """Tracks in view and how long they live, stale tracks cut."""
    in_view = np.diff(sequence.offset)
    length = np.bincount(sequence.track)
    length = length[length > 0]
    few = np.flatnonzero(in_view < _FEW)
    counts = {
        "tracks": len(length),
        "in_view_median": float(np.median(in_view)),
        "in_view_least": int(in_view.min(initial=0)),
        "length_median": float(np.median(length)) if len(length) else 0.0,
        "length_p90": float(np.quantile(length, 0.9)) if len(length) else 0.0,
        "seen_once": int(np.sum(length == 1)),
        "frames_with_few": len(few),
    }
    text = (
        f"{len(length)} tracks, {counts['in_view_median']:.0f} in view (least "
        f"{counts['in_view_least']}), half live for {counts['length_median']:.0f} frames or less, "
        f"a tenth for more than {counts['length_p90']:.0f}, "
        f"{counts['seen_once']} are seen once only"
    )
    series = {"tracks_in_view": in_view.astype(float), "track_length": length.astype(float)}
    if len(few) == 0:
        return Finding("tracks", "ok", text, counts=counts), series
    listed = ", ".join(str(k) for k in few[:_LISTED]) + (" ..." if len(few) > _LISTED else "")
    return Finding(
        "tracks", "note", f"{text}; {len(few)} frames have fewer than {_FEW} ({listed})", counts=counts
    ), series
