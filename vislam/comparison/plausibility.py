"""Plausibility of a recording: units that are wrong by orders of magnitude.

A unit shows in the data alone. Stamps, baseline and lever arm have ranges that hold for a hand-held rig, a
car and a drone alike; velocities and rates are held against the turn and the distance that the camera sees,
whose norms depend on no mounting.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.core.rigid_fit import FEWEST, Continuations, continuations, fit_frames
from vislam.core.sequence import Sequence
from vislam.geometry import so3
from vislam.repair.tracks import DuplicatedTracks

_PERIOD_S = (1e-4, 10.0)
_USUAL_PERIOD_S = 0.05
"""Between a fast camera and a slow one; a guess at a unit is the one that comes nearest."""
_LARGEST_STEP_M = 1000.0
_BASELINE_M = (1e-3, 20.0)
_USUAL_BASELINE_M = 0.3
_LARGEST_LEVER_M = 100.0
_LONGER_STAMPS = {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
_SHORTER_STAMPS = {"minutes": 60.0, "hours": 3600.0, "days": 86400.0}
_LENGTHS = {"millimetres": 1e-3, "centimetres": 1e-2}
_RATIO = 30.0
"""The inertial data are rejected when off by this factor; degrees for radians are off by 57."""
_LEAST_RATIO = 8.0
"""The same of a lower bound, which adds five standard deviations to what the camera sees."""
_ALONE = 3.0
"""Where the distance is off by more, a turn that is off has the same reason."""
_NEAR = 0.2
"""A factor within this share of a unit's is taken for that unit."""
_STEADY = 0.5
"""A unit is off by the same factor in every frame: largest spread (MAD of the logarithm)."""
_FRAMES, _FEWEST_FRAMES = 60, 10
_SMALLEST_DISPARITY_PX = 0.5
_ROWS_PX = 3.0
_SMALLEST_FLOW_PX = 1.0
_EXPLAINED = 0.25
"""A rigid motion explains the flow when it leaves less than this share of it."""
_SIGNIFICANT = 5.0
NOTHING = 1e-6
"""Below it the inertial samples are zero, which is no unit: such a velocity was not measured."""
SPEEDS = {"km/h": 3.6, "mph": 2.237, "knots": 1.944, "feet a second": 3.281, "cm/s": 100.0, "mm/s": 1000.0}
DEGREES = float(np.degrees(1.0))


@dataclass(frozen=True)
class Implausible:
    """One thing that cannot be.

    Attributes
    ----------
    text : str
        What was found and what is expected.
    remedy : str
        The likely reason and what mends it.
    stamp_scale : float
        What the stamps are to be multiplied by, if that is the guess.
    baseline : float or None
        Baseline in the unit that it looks like [m].
    """

    text: str
    remedy: str
    stamp_scale: float = 1.0
    baseline: float | None = None

    def __str__(self) -> str:
        """Both in one line."""
        return f"{self.text}; {self.remedy}"


@dataclass(frozen=True)
class Ratios:
    """Inertial motion over the motion that the camera sees, medians over the frames that show it.

    Attributes
    ----------
    distance, turn : float
        NaN where the camera sees too little of it.
    distance_spread, turn_spread : float
        Robust standard deviation of their logarithms.
    frames : int
        Frames that show the distance.
    """

    distance: float
    turn: float
    turn_least: float
    distance_spread: float
    turn_spread: float
    frames: int


def implausible(sequence: Sequence, *, ratios: Ratios | None = None) -> list[Implausible]:
    """Find what is wrong by orders of magnitude.

    Parameters
    ----------
    sequence : Sequence
    ratios : Ratios, optional
        Those of the sequence, where they are known already.
    """
    found = [*_stamps(sequence), *_rig(sequence)]
    if found:
        # Whatever follows would be off by the same factor.
        return found
    seen = motion_ratios(sequence) if ratios is None else ratios
    return [*_step_length(sequence), *_against_camera(seen)]


def motion_ratios(sequence: Sequence) -> Ratios:
    """Compare the inertial motion with the camera's, frame by frame.

    The rigid fits start from standstill: one that starts from a step of kilometres stays there.
    """
    pixels = sequence.pixels
    possible = (sequence.disparity > _SMALLEST_DISPARITY_PX) & (
        np.abs(pixels[:, 1] - pixels[:, 3]) < _ROWS_PX
    )
    usable = DuplicatedTracks().apply(sequence.select(possible))
    pairs = continuations(usable)
    frames = np.flatnonzero(np.diff(pairs.start) >= FEWEST)
    frames = frames[:: max(1, len(frames) // _FRAMES)]
    means, _ = sequence.step_means()
    z, rig = usable.z, usable.rig
    points = rig.back_project(z)
    rows = []
    flow = np.array([_median_flow(z, pairs, k) for k in frames.tolist()])
    frames, flow = frames[flow >= _SMALLEST_FLOW_PX], flow[flow >= _SMALLEST_FLOW_PX]
    fits = fit_frames(
        rig,
        points,
        z,
        pairs=pairs,
        frames=frames,
        spread=np.ones_like(z),
        guess=np.broadcast_to(np.eye(4), (len(frames), 4, 4)),
    )
    for k, moved, fit in zip(frames, flow, fits, strict=True):
        if float(np.median(np.abs(fit.residual * fit.spread))) > _EXPLAINED * moved:
            continue
        dt = sequence.stamp[k] - sequence.stamp[k - 1]
        sigma = np.sqrt(np.diagonal(fit.cov))
        turn = np.linalg.norm(so3.log(fit.next_T_prev[:3, :3]))
        distance = np.linalg.norm(fit.next_T_prev[:3, 3])
        rows.append(
            [
                distance if distance > _SIGNIFICANT * np.linalg.norm(sigma[3:]) else np.nan,
                turn if turn > _SIGNIFICANT * np.linalg.norm(sigma[:3]) else np.nan,
                np.linalg.norm(means[k, 3:]) * dt,
                np.linalg.norm(means[k, :3]) * dt,
                turn + _SIGNIFICANT * np.linalg.norm(sigma[:3]),
            ]
        )
    table = np.array(rows).reshape(-1, 5)
    distance_ratio, distance_spread, count = _ratio(table[:, 2], table[:, 0])
    turn_ratio, turn_spread, _ = _ratio(table[:, 3], table[:, 1])
    least = float(np.median(table[:, 3] / table[:, 4])) if len(table) >= _FEWEST_FRAMES else float("nan")
    return Ratios(distance_ratio, turn_ratio, least, distance_spread, turn_spread, count)


def _median_flow(z: Array, pairs: Continuations, k: int) -> float:
    """Median of how far the tracks that continue into a frame have moved in it [px]."""
    old, new = (part[pairs.start[k] : pairs.start[k + 1]] for part in (pairs.before, pairs.after))
    return float(np.median(np.linalg.norm(z[new] - z[old], axis=1)))


def _ratio(inertial: Array, seen: Array) -> tuple[float, float, int]:
    """Median ratio, spread of its logarithm and number of frames, of the half in which most is seen."""
    known = np.isfinite(seen)
    if np.count_nonzero(known) >= _FEWEST_FRAMES:
        known &= np.nan_to_num(seen) >= np.median(seen[known])
    if np.count_nonzero(known) < _FEWEST_FRAMES // 2:
        return float("nan"), float("nan"), 0
    logarithm = np.log(np.maximum(inertial[known], 1e-12) / seen[known])
    middle = float(np.median(logarithm))
    spread = 1.4826 * float(np.median(np.abs(logarithm - middle)))
    return float(np.exp(middle)), spread, int(np.count_nonzero(known))


def _stamps(sequence: Sequence) -> list[Implausible]:
    period = float(np.median(np.diff(sequence.stamp)))
    low, high = _PERIOD_S
    if low <= period <= high:
        return []
    units = _LONGER_STAMPS if period > high else _SHORTER_STAMPS
    unit = min(units, key=lambda name: abs(np.log(period * units[name] / _USUAL_PERIOD_S)))
    change = f"divide by {1.0 / units[unit]:.0f}" if units[unit] < 1.0 else f"multiply by {units[unit]:g}"
    return [
        Implausible(
            f"a frame every {period:.6g} s; expected {low:g} to {high:g} s",
            f"time_stamps look like {unit}: {change}, for a frame every {period * units[unit]:.4g} s",
            units[unit],
        )
    ]


def _rig(sequence: Sequence) -> list[Implausible]:
    found = []
    baseline = sequence.rig.baseline
    low, high = _BASELINE_M
    if not low <= baseline <= high:
        unit = _unit_of(baseline, _USUAL_BASELINE_M)
        found.append(
            Implausible(
                f"a baseline of {baseline:g} m; expected {low:g} to {high:g} m",
                f"b looks like {unit}: give it in metres" if unit else "give b in metres",
                baseline=baseline * _LENGTHS[unit] if unit else None,
            )
        )
    lever = float(np.linalg.norm(sequence.rig.imu_T_cam[:3, 3]))
    if lever > _LARGEST_LEVER_M:
        found.append(
            Implausible(
                f"a camera {lever:g} m from the body; expected at most {_LARGEST_LEVER_M:g} m",
                "the translation of the extrinsic looks like millimetres: give it in metres",
            )
        )
    return found


def _unit_of(length: float, usual: float) -> str | None:
    """Unit in which a length comes nearest to a usual one; None if it is too short in metres already."""
    if length < usual:
        return None
    return min(_LENGTHS, key=lambda name: abs(np.log(length * _LENGTHS[name] / usual)))


def _step_length(sequence: Sequence) -> list[Implausible]:
    means, _ = sequence.step_means()
    step = float(np.median(np.linalg.norm(means[1:, 3:], axis=1) * np.diff(sequence.stamp)))
    if step <= _LARGEST_STEP_M:
        return []
    return [
        Implausible(
            f"steps of {step:.4g} m from frame to frame; expected at most {_LARGEST_STEP_M:g} m",
            "the unit of time_stamps or of linear_velocity is wrong: give seconds and m/s",
        )
    ]


def _against_camera(seen: Ratios) -> list[Implausible]:
    distance, turn = (
        ratio if spread < _STEADY and not 1.0 / _RATIO < ratio < _RATIO else None
        for ratio, spread in ((seen.distance, seen.distance_spread), (seen.turn, seen.turn_spread))
    )
    if distance is not None and turn is not None and 1.0 / _RATIO < distance / turn < _RATIO:
        return [
            Implausible(
                f"the inertial data turn {turn:.3g} times and go {distance:.3g} times as far as the camera",
                "both by one factor: the unit of time_stamps is wrong; give seconds",
            )
        ]
    found = []
    if distance is not None and distance > NOTHING:
        found.append(Implausible(distance_text(distance), distance_guess(distance)))
    if turn is not None and turn > NOTHING:
        found.append(Implausible(turn_text(turn), turn_guess(turn)))
    elif np.isnan(seen.turn) and seen.turn_least > _LEAST_RATIO and not seen.distance > _ALONE:
        found.append(Implausible(turn_text(seen.turn_least, bound="at least "), turn_guess(DEGREES)))
    return found


def distance_text(ratio: float) -> str:
    """Compare the inertial distance with the camera's."""
    return f"the inertial data go {ratio:.3g} times as far as the camera sees"


def turn_text(ratio: float, *, bound: str = "") -> str:
    """Compare the inertial rotation with the camera's."""
    return f"the inertial data turn {bound}{ratio:.3g} times as far as the camera sees"


def distance_guess(ratio: float) -> str:
    """Likely reason for a ratio of the distances."""
    unit = _named(ratio, SPEEDS)
    length = _named(ratio, _LENGTHS)
    if unit is not None:
        return f"linear_velocity looks like {unit}: give m/s (or b or K is for another rig)"
    if length is not None:
        return f"b looks like {length}: give metres (or linear_velocity is not in m/s)"
    return "the unit of linear_velocity or of b is wrong, or K is for another resolution: m/s, m and px"


def turn_guess(ratio: float) -> str:
    """Likely reason for a ratio of the turns."""
    if _named(ratio, {"deg/s": DEGREES}) is not None:
        return "angular_velocity looks like deg/s: give rad/s"
    return "the unit of angular_velocity is wrong: give rad/s"


def _named(ratio: float, units: Mapping[str, float]) -> str | None:
    near = {name: abs(np.log(ratio / factor)) for name, factor in units.items()}
    name = min(near, key=near.__getitem__)
    return name if near[name] < _NEAR else None
