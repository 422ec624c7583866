"""Axes and extrinsic: the reading under which one-frame predictions by the inertial data fit the tracks."""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from vislam.data.sequence import Sequence
from vislam.geometry import se3
from vislam.inspection.finding import Finding
from vislam.repair import RepairConfig
from vislam.repair.mounting import Axes, Extrinsic, Reading, axes_rotation
from vislam.types import Array
from vislam.vision import continuations, inertial_steps

_PAIRS = 12_000
_BLOCK = 10
_CLEARLY = 3.5
"""Standard deviations by which a reading must do better to be believed in place of a simpler one."""
_NEAREST = 1.0
_SMALLEST_DISPARITY = 3.0
_WORST_PX = 50.0
_FEWEST = 4
"""Fewest pairs that make a frame's median."""


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


def check_mounting(sequence: Sequence, repair: RepairConfig) -> tuple[Finding, Candidate, dict[str, Array]]:
    """Rank all readings by their one-frame reprojection error.

    Parameters
    ----------
    sequence : Sequence
        Extrinsic as the file has it, stale tracks cut.
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
    everyone = candidates()
    own = configured(repair)
    sample = _Sample(sequence)
    errors = np.array([sample.frame_errors(candidate) for candidate in everyone])
    errors = errors[:, np.all(np.isfinite(errors), axis=0)]
    if errors.shape[1] < 2 * _BLOCK:
        text = f"only {errors.shape[1]} frames have tracks enough to tell"
        return Finding("axes and extrinsic", "unclear", text), own, {"mounting_score": np.empty(0)}
    score = np.median(errors, axis=1)
    ranking = np.argsort(score, kind="stable")
    best = _simplest_of_the_best(everyone, errors, own)
    rank = [f"{everyone[index]}: {score[index]:.2f} px" for index in ranking[:5]]
    series = {"mounting_score": score[ranking]}
    at_best, at_own = everyone.index(best), everyone.index(own)
    others = [index for index in ranking if everyone[index].axes != best.axes]
    margin = float(score[others[0]] / score[at_best])
    counts = {"best_px": float(score[at_best]), "configured_px": float(score[at_own]), "margin": margin}
    if best == own:
        text = (
            f"as configured, {best}: {score[at_best]:.2f} px; the next axes leave {margin:.2f} times that. "
            f"First of {len(everyone)}: {'; '.join(rank[:3])}"
        )
        return Finding("axes and extrinsic", "ok", text, counts=counts), own, series
    proposal: dict[str, object] = {
        "data.repair.axes": None if best.axes == ("x", "y", "z") else {"body": list(best.axes)},
        "data.repair.extrinsic": None
        if (best.rotation, best.translation) == ("stored", "stored")
        else {"rotation": best.rotation, "translation": best.translation},
    }
    text = (
        f"configured {own} leaves {score[at_own]:.2f} px, {best} {score[at_best]:.2f} px: the extrinsic does "
        f"not fit the velocities as configured. First of {len(everyone)}: {'; '.join(rank)}"
    )
    return Finding("axes and extrinsic", "fault", text, counts=counts, proposal=proposal), best, series


def _simplest_of_the_best(everyone: list[Candidate], errors: Array, own: Candidate) -> Candidate:
    """Configured reading, or the simplest of those that no other clearly beats."""
    logarithm = np.log(np.maximum(errors, 0.05))
    leader = int(np.argmin(logarithm.mean(axis=1)))
    rivals = [
        candidate
        for candidate, mine in zip(everyone, logarithm, strict=True)
        if not _clearly_better(logarithm[leader], mine)
    ]
    if own in rivals:
        return own
    fewest = min(candidate.steps for candidate in rivals)
    simple = [candidate for candidate in rivals if candidate.steps == fewest]
    return min(simple, key=lambda candidate: float(logarithm[everyone.index(candidate)].mean()))


def _clearly_better(one: Array, other: Array) -> bool:
    """Whether the first series of log errors is lower by many standard deviations of its block means."""
    difference = other - one
    blocks = np.array([part.mean() for part in np.array_split(difference, max(2, len(difference) // _BLOCK))])
    error = blocks.std(ddof=1) / np.sqrt(len(blocks))
    return bool(blocks.mean() > _CLEARLY * error + 1e-12)


class _Sample:
    """Pairs of sightings that all candidates are tried on, and what does not depend on the mounting."""

    def __init__(self, sequence: Sequence) -> None:
        pairs = continuations(sequence)
        z = sequence.z
        near = np.flatnonzero(sequence.disparity[pairs.before] > _SMALLEST_DISPARITY)
        chosen = near[:: max(1, len(near) // _PAIRS)]
        before, after = pairs.before[chosen], pairs.after[chosen]
        self._sequence = sequence
        self._points = sequence.rig.back_project(z[before])
        self._z = z[after]
        # Pairs come frame after frame, so the medians of frames are those of slices.
        self._frame = sequence.frame_of[after]
        self._edges = np.searchsorted(self._frame, np.arange(len(sequence) + 1))
        self._next_T_prev = inertial_steps(sequence)

    def frame_errors(self, candidate: Candidate) -> Array:
        """Median error ``(T,)`` [px] of each frame predicted from the one before; NaN without tracks."""
        rig = mounted(self._sequence, candidate).rig
        step = rig.cam_T_imu @ self._next_T_prev @ rig.imu_T_cam
        moved = se3.transform(step[self._frame], self._points[:, None])[:, 0]
        behind = moved[:, 2] < _NEAREST
        moved[:, 2] = np.maximum(moved[:, 2], _NEAREST)
        error = np.linalg.norm(rig.project(moved) - self._z, axis=1)
        error[behind] = _WORST_PX
        out = np.full(len(self._sequence), np.nan)
        for k in np.flatnonzero(np.diff(self._edges) >= _FEWEST):
            out[k] = np.median(error[self._edges[k] : self._edges[k + 1]])
        return out
