"""Units: baseline and lever arm by their ranges, the inertial data against the camera's own motion."""

from dataclasses import replace

import numpy as np

from vislam.comparison.plausibility import (
    DEGREES,
    NOTHING,
    Ratios,
    distance_guess,
    distance_text,
    implausible,
    motion_ratios,
    turn_guess,
    turn_text,
)
from vislam.core.sequence import Sequence
from vislam.inspection.finding import Finding

_OFF = 1.5
"""Inertial distance over the camera's, or its inverse, that no calibration error explains."""
_STEADY = 0.35
"""Spread (MAD of the logarithm) below which a ratio is one factor, not noise."""
_NEAR_DEGREES = 0.25
_ALIKE = 0.2
"""Two factors whose logarithms differ by less are one."""
_TURN_OFF = 10.0


def in_plausible_units(raw: Sequence) -> Sequence:
    """Sequence with stamps and baseline in the units that they look like, so that the rest can be checked.

    The sequence itself where nothing about it is implausible.
    """
    for item in implausible(raw):
        scale, imu = item.stamp_scale, raw.imu
        raw = replace(
            raw,
            stamp=raw.stamp * scale,
            inertial_stamp=raw.inertial_stamp * scale,
            imu=None if imu is None else replace(imu, stamp=imu.stamp * scale),
        )
        if item.baseline is not None:
            raw = replace(raw, rig=replace(raw.rig, baseline=item.baseline))
    return raw


def check_units(recorded: Sequence, believed: Sequence) -> Finding:
    """Find wrong units of baseline, lever arm and velocities; those of the stamps have a check of their own.

    Parameters
    ----------
    recorded : Sequence
        As the file has it, with the baseline that the config gives it.
    believed : Sequence
        The same in plausible units.
    """
    ratios = motion_ratios(believed)
    as_read = implausible(recorded, ratios=ratios if recorded is believed else None)
    found = [item for item in as_read if item.stamp_scale == 1.0]
    found += [item for item in implausible(believed, ratios=ratios) if item not in found]
    if not found:
        return _against_camera(ratios)
    text = "; ".join(str(item) for item in found)
    baselines = [item.baseline for item in found if item.baseline is not None]
    proposal = {"data.repair.baseline": {"metres": baselines[0]}} if baselines else {}
    # No step of the config mends the rest: the file is to be written again.
    unknown = {} if len(baselines) == len(found) else {"data.file": _refused(text)}
    return Finding("units", "fault", text, proposal=proposal, unknown=unknown)


def _refused(text: str) -> str:
    return f"compare rejects this recording until its units are mended: {text}"


def _against_camera(ratios: Ratios) -> Finding:
    """Ratios that are off by a factor, but by no order of magnitude."""
    counts = {"distance_ratio": ratios.distance, "turn_ratio": ratios.turn, "frames": ratios.frames}
    without_velocity = ratios.distance < NOTHING
    if without_velocity:
        ratios = replace(ratios, distance=float("nan"), distance_spread=float("inf"))
    steady = ratios.distance_spread < _STEADY and ratios.turn_spread < _STEADY
    apart = abs(np.log(max(ratios.turn, 1e-12)) - np.log(max(ratios.distance, 1e-12)))
    off = []
    if steady and apart < _ALIKE and not 1.0 / _OFF < ratios.distance < _OFF:
        text = f"{distance_text(ratios.distance)}, and turn {ratios.turn:.3g} times as far"
        off.append(f"{text}; both by one factor: time_stamps are no seconds, or K is for another lens")
    else:
        off += _each_alone(ratios)
    if off:
        unknown = {"data.file": f"the units of this recording are in doubt: {'; '.join(off)}"}
        return Finding("units", "fault", "; ".join(off), counts=counts, unknown=unknown)
    if ratios.frames == 0 and not np.isfinite(ratios.turn):
        text = "too little motion, or too few sound tracks, to hold the units of the inertial data against"
        return Finding("units", "unclear", text, counts=counts)
    seen = [distance_text(ratios.distance)] if np.isfinite(ratios.distance) else []
    seen += [turn_text(ratios.turn)] if np.isfinite(ratios.turn) else []
    seen += ["the velocity is 0 throughout: none was recorded"] if without_velocity else []
    return Finding("units", "ok", "; ".join(seen), counts=counts)


def _each_alone(ratios: Ratios) -> list[str]:
    """What is off in the distance and in the turn."""
    off = []
    if ratios.distance_spread < _STEADY and not 1.0 / _OFF < ratios.distance < _OFF:
        off.append(f"{distance_text(ratios.distance)}; {distance_guess(ratios.distance)}")
    degrees = abs(np.log(max(ratios.turn, 1e-12)) - np.log(DEGREES)) < _NEAR_DEGREES
    if degrees or (ratios.turn_spread < _STEADY and not 1.0 / _TURN_OFF < ratios.turn < _TURN_OFF):
        off.append(f"{turn_text(ratios.turn)}; {turn_guess(ratios.turn)}")
    return off
