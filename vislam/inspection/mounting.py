"""Axes and extrinsic: the reading under which one-frame predictions by the inertial data fit the tracks."""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from vislam.base.types import Array
from vislam.core.rigid_fit import continuations, inertial_steps
from vislam.core.sequence import Sequence
from vislam.geometry import se3, so3
from vislam.geometry.axes import axes_rotation
from vislam.inspection.finding import Finding, Verdict
from vislam.repair import RepairConfig
from vislam.repair.mounting import Axes, Extrinsic, Reading

_CHECK = "axes and extrinsic"
_PAIRS = 12_000
_BLOCK = 10
_CLEARLY = 3.5
"""Standard deviations by which a reading must do better to be believed in place of a simpler one."""
_SMALLEST_DISPARITY = 3.0
_WORST_PX = 50.0
_FEWEST = 4
"""Fewest pairs that make a frame's median."""
MARGIN = 1.1
"""A reading that leaves less than this many times the error of another is not told from it."""
_SAME_DEG = 0.05
NEAR_DEG = 3.0
"""The velocity may point beside the body's axis by a degree: readings that differ less are not told apart."""
_NOTHING_FITS_PX = 10.0
_SMALLEST_FLOW_PX = 1.0


@dataclass(frozen=True)
class Candidate:
    """One way to read the mounting: turn of the body axes, direction of the two parts of the extrinsic."""

    axes: tuple[str, str, str]
    rotation: Reading
    translation: Reading

    @property
    def steps(self) -> int:
        """How many repairs it takes."""
        turned = self.axes != ("x", "y", "z")
        return int(turned) + int(self.rotation == "inverse") + int(self.translation == "inverse")

    def __str__(self) -> str:
        """As the ranking prints it."""
        return f"[{', '.join(self.axes)}] rotation {self.rotation}, translation {self.translation}"


def candidates() -> list[Candidate]:
    """All 24 proper turns of the axes under all four readings of the extrinsic."""
    turns = []
    for order in permutations("xyz"):
        for signs in product(("", "-"), repeat=3):
            axes = (signs[0] + order[0], signs[1] + order[1], signs[2] + order[2])
            try:
                axes_rotation(axes)
            except ValueError:
                continue
            turns.append(axes)
    readings: tuple[Reading, Reading] = ("stored", "inverse")
    return [
        Candidate(axes, rotation, translation)
        for axes in turns
        for rotation in readings
        for translation in readings
    ]


def configured(repair: RepairConfig) -> Candidate:
    """Reading that a config has."""
    extrinsic = repair.extrinsic
    axes = ("x", "y", "z") if repair.axes is None else repair.axes.body
    if extrinsic is None:
        return Candidate(axes, "stored", "stored")
    return Candidate(axes, extrinsic.rotation, extrinsic.translation)


def mounted(sequence: Sequence, candidate: Candidate) -> Sequence:
    """Sequence with the extrinsic read that way."""
    read = Extrinsic(rotation=candidate.rotation, translation=candidate.translation).apply(sequence)
    return Axes(body=candidate.axes).apply(read)


@dataclass(frozen=True)
class Ranking:
    """How all readings do.

    Attributes
    ----------
    everyone : list of Candidate
    errors : (n, f)
        One-frame reprojection error of each reading in each frame that tells [px].
    flow_px : float
        What a camera that stands still would leave, median of the same frames.
    turns : (n, 3, 3)
        Rotation of the camera in the body by each reading.
    """

    everyone: list[Candidate]
    errors: Array
    flow_px: float
    turns: Array

    @property
    def score(self) -> Array:
        """Median error of each reading [px]."""
        return np.median(self.errors, axis=1)

    def apart_deg(self, one: Candidate, other: Candidate) -> float:
        """Angle between the rotations of two readings [deg]."""
        first, second = (self.turns[self.everyone.index(item)] for item in (one, other))
        return float(np.degrees(np.linalg.norm(so3.log(first.T @ second))))


def check_mounting(sequence: Sequence, repair: RepairConfig) -> tuple[Finding, Candidate, dict[str, Array]]:
    """Rank all readings of axes and rotation by their one-frame reprojection error.

    Parameters
    ----------
    sequence : Sequence
        Extrinsic as the file has it, duplicated tracks cut.
    repair : RepairConfig
        What is configured.

    Returns
    -------
    Finding
    Candidate
        The reading to go on with: the configured one unless another is clearly better.
    dict
        Series for the figures.
    """
    own = configured(repair)
    ranking = _rank(sequence)
    if ranking.errors.shape[1] < 2 * _BLOCK:
        text = f"only {ranking.errors.shape[1]} frames have enough tracks"
        return Finding(_CHECK, "unclear", text, unknown=_unknown(text)), own, {}
    series = {"mounting_score": np.sort(ranking.score)}
    none = _nothing_fits(ranking)
    if none is not None:
        return none, own, series
    rivals = _rivals(ranking, own)
    best = own if own in rivals else _simplest(ranking, rivals)
    return _ranked(ranking, rivals, best, own), best, series


def _rank(sequence: Sequence) -> Ranking:
    everyone = candidates()
    sample = _Sample(sequence)
    errors = np.array([sample.frame_errors(candidate) for candidate in everyone])
    flow = sample.flow()
    known = np.all(np.isfinite(errors), axis=0)
    return Ranking(
        everyone,
        errors[:, known],
        float(np.median(flow[known])) if known.any() else float("nan"),
        np.array([mounted(sequence, candidate).rig.imu_T_cam[:3, :3] for candidate in everyone]),
    )


def _nothing_fits(ranking: Ranking) -> Finding | None:
    """Finding where no reading predicts the tracks better than a camera at rest, or where it is at rest."""
    least, flow = float(ranking.score.min()), ranking.flow_px
    counts = {"best_px": least, "flow_px": flow}
    if least > _NOTHING_FITS_PX and (least > flow or least > 0.9 * _WORST_PX):
        text = (
            f"no reading of axes and extrinsic predicts the tracks: the best of {len(ranking.everyone)} "
            f"leaves {least:.2f} px, the tracks move by {flow:.2f} px: velocities, stamps, baseline or "
            "K are wrong"
        )
        unknown = _unknown("no reading predicts the tracks")
        return Finding(_CHECK, "fault", text, counts=counts, unknown=unknown)
    if flow < _SMALLEST_FLOW_PX:
        text = f"the tracks move by {flow:.2f} px from frame to frame, too little to determine the mounting"
        return Finding(_CHECK, "unclear", text, counts=counts, unknown=_unknown(text))
    return None


def _unknown(reason: str) -> dict[str, str]:
    return dict.fromkeys(("data.repair.axes", "data.repair.extrinsic"), f"{reason}; read as configured")


def _rivals(ranking: Ranking, own: Candidate) -> list[Candidate]:
    """Readings that are not distinguishable from the one with the least error.

    A reading whose rotation is within a few degrees of that is among them, and so is the configured one.
    """
    logarithm = np.log(np.maximum(ranking.errors, 0.05))
    at = int(np.argmin(logarithm.mean(axis=1)))
    leader, score = ranking.everyone[at], ranking.score
    return [
        candidate
        for index, candidate in enumerate(ranking.everyone)
        if score[index] < MARGIN * score[at]
        or not clearly_better(logarithm[at], logarithm[index])
        or (candidate == own and ranking.apart_deg(candidate, leader) < NEAR_DEG)
    ]


def _simplest(ranking: Ranking, rivals: list[Candidate]) -> Candidate:
    """Reading of the fewest repairs, and of these the one of the least error."""
    return min(rivals, key=lambda item: (item.steps, ranking.score[ranking.everyone.index(item)]))


def _ranked(ranking: Ranking, rivals: list[Candidate], best: Candidate, own: Candidate) -> Finding:
    """Finding on the reading that was chosen."""
    score = dict(zip(ranking.everyone, ranking.score.tolist(), strict=True))
    order = sorted(ranking.everyone, key=score.__getitem__)
    rank = f"First of {len(order)}: " + "; ".join(f"{item}: {score[item]:.2f} px" for item in order[:5])
    others = [item for item in order if ranking.apart_deg(item, best) > _SAME_DEG]
    margin = score[others[0]] / max(score[best], 1e-9)
    counts = {
        "best_px": score[best],
        "configured_px": score[own],
        "margin": margin,
        "flow_px": ranking.flow_px,
    }
    equal = [item for item in others if item in rivals]
    doubt, unknown = "", {}
    if equal:
        apart = ranking.apart_deg(equal[0], best)
        more = f" and {len(equal) - 1} more" if len(equal) > 1 else ""
        doubt = f", not told from {equal[0]} ({score[equal[0]]:.2f} px, rotation {apart:.1f} deg apart){more}"
        unknown = _unknown(f"{best} ({score[best]:.2f} px){doubt}")
    if best == own:
        verdict: Verdict = "unclear" if equal else "ok"
        text = (
            f"as configured, {best}: {score[best]:.2f} px{doubt}; the next rotation leaves {margin:.2f} "
            f"times that. {rank}"
        )
        return Finding(_CHECK, verdict, text, counts=counts, unknown=unknown)
    proposal: dict[str, object] = {
        "data.repair.axes": None if best.axes == ("x", "y", "z") else {"body": list(best.axes)},
        "data.repair.extrinsic": extrinsic_setting(best),
    }
    text = (
        f"configured {own} leaves {score[own]:.2f} px, {best} {score[best]:.2f} px{doubt}: the extrinsic "
        f"does not fit the velocities as configured. {rank}"
    )
    return Finding(_CHECK, "fault", text, counts=counts, proposal=proposal, unknown=unknown)


def extrinsic_setting(reading: Candidate) -> dict[str, str] | None:
    """Value of ``data.repair.extrinsic`` for a reading."""
    if (reading.rotation, reading.translation) == ("stored", "stored"):
        return None
    return {"rotation": reading.rotation, "translation": reading.translation}


def clearly_better(one: Array, other: Array) -> bool:
    """Whether the first series of log errors is lower by many standard deviations of its block means."""
    difference = other - one
    blocks = np.array([part.mean() for part in np.array_split(difference, max(2, len(difference) // _BLOCK))])
    error = blocks.std(ddof=1) / np.sqrt(len(blocks))
    return bool(blocks.mean() > _CLEARLY * error + 1e-12)


class _Sample:
    """Pairs of observations that all candidates are tried on, and what does not depend on the mounting."""

    def __init__(self, sequence: Sequence) -> None:
        pairs = continuations(sequence)
        z = sequence.z
        near = np.flatnonzero(sequence.disparity[pairs.before] > _SMALLEST_DISPARITY)
        chosen = near[:: max(1, len(near) // _PAIRS)]
        before, after = pairs.before[chosen], pairs.after[chosen]
        self._sequence = sequence
        self._points = sequence.rig.back_project(z[before])
        self._flow = np.linalg.norm(z[after] - z[before], axis=1)
        self._z = z[after]
        # Nearer, the disparity would be wider than the image.
        self._nearest = sequence.rig.nearest
        # Pairs come frame after frame, so the medians of frames are those of slices.
        self._frame = sequence.frame_of[after]
        self._edges = np.searchsorted(self._frame, np.arange(len(sequence) + 1))
        self._next_T_prev = inertial_steps(sequence)

    def frame_errors(self, candidate: Candidate) -> Array:
        """Median error ``(T,)`` [px] of each frame predicted from the one before; NaN without tracks."""
        rig = mounted(self._sequence, candidate).rig
        step = rig.cam_T_imu @ self._next_T_prev @ rig.imu_T_cam
        moved = se3.transform(step[self._frame], self._points[:, None])[:, 0]
        behind = moved[:, 2] < self._nearest
        moved[:, 2] = np.maximum(moved[:, 2], self._nearest)
        error = np.linalg.norm(rig.project(moved) - self._z, axis=1)
        error[behind] = _WORST_PX
        return self._medians(error)

    def flow(self) -> Array:
        """Median length ``(T,)`` [px] by which the tracks move into each frame; NaN without tracks."""
        return self._medians(self._flow)

    def _medians(self, values: Array) -> Array:
        out = np.full(len(self._sequence), np.nan)
        for k in np.flatnonzero(np.diff(self._edges) >= _FEWEST):
            out[k] = np.median(values[self._edges[k] : self._edges[k + 1]])
        return out
