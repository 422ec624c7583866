"""Tracks and stamps: duplicated frames, repeats, gaps, and whether there are tracks enough."""

from dataclasses import replace

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.comparison.plausibility import implausible
from vislam.core.filled import filled
from vislam.core.rigid_fit import FEWEST, continuations
from vislam.core.sequence import Sequence
from vislam.inspection.finding import Finding, Verdict
from vislam.repair import RepairConfig
from vislam.repair.tracks import duplicated_observations

_FEW = 10
"""A frame with fewer tracks says little about its motion."""
_GAP = 1.5
"""A step this many times the usual one misses a frame."""
_MOST = 0.5
_LEAST = 3
_LISTED = 12
_SEEN_AGAIN = 0.25
"""Share of the tracks that come back from which on ids are taken for those of landmarks."""
LANDMARKS = "data.landmarks"
_REMEMBERED = "most 100"
"""Landmarks out of view that are kept then: a bound on what a step of a filter takes."""


def check_duplicated(sequence: Sequence, repair: RepairConfig) -> tuple[Finding, dict[str, Array]]:
    """Frames in which most tracks repeat the pixels of the frame before, bit for bit."""
    duplicated, repeats = duplicated_observations(sequence)
    frames = np.flatnonzero(duplicated)
    in_duplicated = int(repeats[duplicated[sequence.frame_of]].sum())
    lone = int(repeats.sum()) - in_duplicated
    share = len(frames) / max(len(sequence) - 1, 1)
    counts = {
        "duplicated_frames": len(frames),
        "observations": in_duplicated,
        "lone_repeats": lone,
        "share": share,
    }
    series = {"duplicated_frames": frames.astype(float)}
    if len(frames) == 0:
        return Finding(
            "duplicated tracks", "ok", f"no duplicated frame; {lone} lone repeats", counts=counts
        ), series
    listed = ", ".join(str(k) for k in frames[:_LISTED]) + (" ..." if len(frames) > _LISTED else "")
    text = (
        f"{len(frames)} frames ({listed}) repeat the pixels of the frame before in {in_duplicated} "
        "observations, then follow other points; uncorrected they indicate no motion and shorten the path by "
        f"{100 * share:.0f} %; {lone} lone repeats besides"
    )
    if repair.duplicated_tracks is not None:
        return Finding(
            "duplicated tracks", "ok", f"{text}; the configured cut answers it", counts=counts
        ), series
    proposal = {"data.repair.duplicated_tracks": True}
    return Finding("duplicated tracks", "fault", text, counts=counts, proposal=proposal), series


def check_stamps(recorded: Sequence, *, in_seconds: Sequence) -> Finding:
    """Steps of the camera and inertial stamps; the reader has rejected what does not increase.

    Parameters
    ----------
    recorded : Sequence
    in_seconds : Sequence
        The same with stamps that are believed; it differs where those of the recording are in another unit.
    """
    finding = _steps(in_seconds)
    wrong = [item for item in implausible(recorded) if item.stamp_scale != 1.0]
    if not wrong:
        return finding
    unknown = {"data.file": f"compare rejects this recording until its stamps are mended: {wrong[0]}"}
    return replace(finding, verdict="fault", text=f"{wrong[0]}; in seconds: {finding.text}", unknown=unknown)


def _steps(sequence: Sequence) -> Finding:
    step = np.diff(sequence.stamp)
    usual = float(np.median(step))
    gaps = np.flatnonzero(step > _GAP * usual)
    missing = int(np.round(step[gaps] / usual - 1.0).sum())
    inertial = np.diff(sequence.inertial_stamp)
    inertial_gaps = int(np.sum(inertial > 2.0 * max(usual, float(np.median(inertial)))))
    number = np.arange(float(len(sequence.twist)))
    computed = np.flatnonzero(filled(sequence.twist, number, sequence.inertial_stamp))
    counts = {
        "period_s": usual,
        "gaps": len(gaps),
        "frames_missing": missing,
        "longest_step_s": float(step.max()),
        "inertial_gaps": inertial_gaps,
        "inertial_filled": len(computed),
    }
    told = f"; {_filled_in(sequence.inertial_stamp - sequence.stamp[0], computed)}" if len(computed) else ""
    if len(gaps) + inertial_gaps == 0:
        text = f"{len(sequence)} frames every {usual:.4f} s, no gap{told}"
        return Finding("stamps", "note" if told else "ok", text, counts=counts)
    listed = ", ".join(str(k + 1) for k in gaps[:_LISTED])
    text = (
        f"{len(gaps)} gaps (before frames {listed}), {missing} frames missing, longest step "
        f"{step.max():.3f} s, {inertial_gaps} gaps in the inertial samples: nothing spans them{told}"
    )
    return Finding("stamps", "note", text, counts=counts)


def _filled_in(at: Array, computed: IntArray) -> str:
    """Say which inertial samples lie between others in equal steps."""
    first, last = at[computed[0]], at[computed[-1]]
    return (
        f"{len(computed)} inertial samples from {first:.1f} to {last:.1f} s lie between others in exactly "
        "equal steps: filled in, not measured, as is a reference of the same instrument"
    )


def check_seen_again(sequence: Sequence, *, kept: str) -> Finding:
    """Whether track ids come back after they were out of view, as those of known landmarks do.

    Parameters
    ----------
    sequence : Sequence
        Tracks as the file has them, duplicated ones cut.
    kept : str
        As configured.
    """
    frame, track = sequence.frame_of, sequence.track
    order = np.lexsort((frame, track))
    gap = np.diff(frame[order])[np.diff(track[order]) == 0]
    back = int(np.sum(gap > 1))
    count = len(np.unique(track))
    again = len(np.unique(track[order][1:][(np.diff(track[order]) == 0) & (np.diff(frame[order]) > 1)]))
    counts: dict[str, float] = {"tracks": count, "seen_again": again, "returns": back}
    text = f"{again} of {count} tracks come back after they were out of view, {back} times in all"
    if back == 0 or again < _SEEN_AGAIN * count:
        return Finding("landmarks seen again", "ok", text, counts=counts)
    text = (
        f"{text}, for {np.median(gap[gap > 1]) - 1:.0f} frames half of the times: ids are those of landmarks"
    )
    settings = {LANDMARKS: {"kept": _REMEMBERED}}
    if kept != "while_tracked":
        text = f"{text}; kept: {kept} as configured"
    return Finding("landmarks seen again", "note", text, counts=counts, settings=settings)


def check_track_counts(sequence: Sequence) -> tuple[Finding, dict[str, Array]]:
    """Tracks in view and their lengths, duplicated tracks cut; whether they suffice to observe the motion."""
    in_view = np.diff(sequence.offset)
    length = np.bincount(sequence.track)
    length = length[length > 0]
    continuing = np.diff(continuations(sequence).start)[1:]
    seeing = int(np.sum(continuing >= FEWEST))
    few = np.flatnonzero(in_view < _FEW)
    counts = {
        "tracks": len(length),
        "in_view_median": float(np.median(in_view)),
        "in_view_least": int(in_view.min()),
        "length_median": float(np.median(length)) if len(length) else 0.0,
        "length_p90": float(np.quantile(length, 0.9)) if len(length) else 0.0,
        "seen_once": int(np.sum(length == 1)),
        "frames_with_few": len(few),
        "frames_that_see_motion": seeing,
    }
    text = (
        f"{len(length)} tracks, {counts['in_view_median']:.0f} in view (least "
        f"{counts['in_view_least']}), half live for {counts['length_median']:.0f} frames or less, "
        f"a tenth for more than {counts['length_p90']:.0f}, "
        f"{counts['seen_once']} are seen once only"
    )
    series = {"tracks_in_view": in_view.astype(float), "track_length": length.astype(float)}
    if seeing < _MOST * len(continuing):
        headline = (
            f"few tracks: in {seeing} of {len(continuing)} steps only do {FEWEST} tracks or more go on, "
            "fewer do not show the camera's motion; what rests on it is of those steps or was not looked at"
        )
        # Three points fix a pose; with fewer the inertial data carry the estimate, whatever the filter says.
        alone = float(np.median(continuing)) < _LEAST
        if alone:
            headline = (
                f"{headline}; half of the steps have fewer than {_LEAST}: the pose rests on the inertial data"
            )
        verdict: Verdict = "fault" if alone else "unclear"
        return Finding("tracks", verdict, f"{headline}; {text}", counts=counts), series
    if len(few) == 0:
        return Finding("tracks", "ok", text, counts=counts), series
    listed = ", ".join(str(k) for k in few[:_LISTED]) + (" ..." if len(few) > _LISTED else "")
    return Finding(
        "tracks", "note", f"{text}; {len(few)} frames have fewer than {_FEW} ({listed})", counts=counts
    ), series
