"""All checks in their order: each works on the sequence as mended by what the checks before it have found."""

from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from vislam.base.settings import LONGEST_NAME
from vislam.base.types import Array
from vislam.comparison import config as configuration
from vislam.comparison.config import Config, DataConfig, LandmarksConfig
from vislam.core.pooled_fit import inertial_pairs, twist_error
from vislam.core.rigid_fit import RigidFit, continuations, rigid_fits
from vislam.core.sequence import Sequence
from vislam.evaluation.held_out import hold_out
from vislam.inspection import biases, motion, mounting, observations, pixels, stereo, tracks, units
from vislam.inspection.finding import Finding, Inspection
from vislam.inspection.inertia import check_inertia, takes_raw_inertia
from vislam.inspection.inertia.units import PATH as UNITS_OF_INERTIA
from vislam.inspection.lever_arm import check_lever_arm
from vislam.inspection.rates import check_rate_axes
from vislam.inspection.shared_errors import check_shared_errors
from vislam.repair import RepairConfig, apply
from vislam.repair.consensus import Consensus
from vislam.repair.inertial import Clock, NavigationFrameRates, NavigationFrameVelocity
from vislam.repair.mounting import Baseline
from vislam.repair.pixels import Disparity, DisparityOffset
from vislam.repair.tracks import DuplicatedTracks, Interruptions, SingleObservations

_FEWEST_FRAMES = 20
_KEPT = 0.5
"""Repairs that leave less than this share are not proposed, and a step that does so is a fault."""
_REPAIR = "data.repair."
_STEREO = ("stereo scale", "disparity offset")
_NEEDS_MOTION = (
    "data.repair.axes",
    "data.repair.extrinsic",
    "data.repair.baseline",
    "data.repair.clock",
    "data.repair.navigation_frame_rates",
    "data.repair.disparity_offset",
    "data.repair.consensus",
    "noise.pixel_sigma_px",
    "noise.drift_px",
    "noise.matching_bias_px",
    "noise.bias_mean",
    "noise.bias_sigma",
)
"""Settings that the camera's own motion determines."""
_TOLD_TOGETHER = ("data.repair.consensus", "noise.bias_mean", "noise.bias_sigma")
"""Those of them that the tracks of all steps together determine, too."""
_DROPPING = ("disparity", "consensus", "duplicated_tracks")


@dataclass
class _Book:
    """What the checks have found so far."""

    found: list[Finding] = field(default_factory=list)
    series: dict[str, Array] = field(default_factory=dict)

    def enter(self, finding: Finding, series: dict[str, Array] | None = None) -> Finding:
        """Take a finding and what its figure is drawn from."""
        self.found.append(finding)
        self.series |= series or {}
        return finding


def inspect_sequence(raw: Sequence, config: Config) -> Inspection:
    """Inspect a sequence as its file has it, but for the tracks that the config holds out.

    What is proposed goes into the runs that are scored by them.

    Parameters
    ----------
    raw : Sequence
        With no repair applied.
    config : Config
        What is configured: a check finds a fault where that does not answer what the data shows.
    """
    book = _Book()
    repair = config.data.repair
    raw = raw.select(~hold_out(raw.track, share=config.held_out.share, seed=config.held_out.seed))
    for step in (repair.baseline, repair.imu_units):
        if step is not None:
            raw = step.apply(raw)
    sequence = units.in_plausible_units(raw)
    book.enter(tracks.check_stamps(raw, in_seconds=sequence))
    book.enter(units.check_units(raw, sequence))
    book.enter(observations.check_observations(sequence, repair))
    book.enter(*tracks.check_duplicated(sequence, repair))
    uncut = DuplicatedTracks().apply(sequence)
    book.enter(tracks.check_seen_again(uncut, kept=config.data.landmarks.kept))
    cut = Interruptions().apply(uncut)
    few = book.enter(*tracks.check_track_counts(cut))
    plausible = _as_configured(Disparity().apply(cut), repair)
    if plausible.imu is not None:
        configured = mounting.mounted(plausible, mounting.configured(repair))
        for finding, series in check_inertia(configured, config):
            book.enter(finding, series)
    if takes_raw_inertia(plausible, config):
        _check_tracks(plausible, config, book)
    else:
        _check_motion(plausible, config, book)
    found = _checked_repairs(sequence, config.data, _of_one_gyro(raw, book.found))
    if few.verdict in ("fault", "unclear"):
        # What all others rest on goes first.
        found = [few, *(item for item in found if item.check != few.check)]
    return Inspection(raw.name, tuple(found), book.series)


def _of_one_gyro(raw: Sequence, found: list[Finding]) -> list[Finding]:
    """Findings in which the repaired unit of a gyro answers for rates of the twist that are its own."""
    if raw.imu is None or not np.array_equal(raw.twist[:, :3], raw.imu.gyro):
        return found
    if not any(UNITS_OF_INERTIA in item.proposal for item in found):
        return found
    return [replace(item, unknown={}) if item.check == "units" else item for item in found]


def _checked_repairs(sequence: Sequence, data: DataConfig, found: list[Finding]) -> list[Finding]:
    """Findings without the proposals of steps that would leave nearly nothing, and what the repairs leave."""
    proposed = _repaired(sequence, data, found)
    if proposed.observations < _KEPT * _repaired(sequence, data, []).observations:
        found = [_withdrawn(item, proposed.observations, sequence.observations) for item in found]
        proposed = _repaired(sequence, data, found)
    counts: dict[str, float] = {"observations": proposed.observations, "of": sequence.observations}
    left = f"with what is proposed they leave {proposed.observations} of {sequence.observations} observations"
    heavy = [
        f"{step.name} drops {step.before - step.after} of {step.before}"
        for step in proposed.repairs
        if step.after < _KEPT * step.before
    ]
    if not heavy:
        return [*found, Finding("repairs", "ok", left, counts=counts)]
    text = f"{left}: {', '.join(heavy)}"
    unknown = {"data.repair": f"whether they suit this recording: {text}"}
    return [*found, Finding("repairs", "fault", text, counts=counts, unknown=unknown)]


def _repaired(sequence: Sequence, data: DataConfig, found: list[Finding]) -> Sequence:
    """Sequence under the configured repairs and those that the findings propose."""
    tree: dict[str, Any] = asdict(data.repair)
    landmarks = data.landmarks
    for finding in found:
        if tracks.LANDMARKS in finding.settings and not landmarks.most:
            landmarks = LandmarksConfig(**finding.settings[tracks.LANDMARKS])
        for path, value in finding.proposal.items():
            if path.startswith(_REPAIR):
                tree[path.removeprefix(_REPAIR)] = value
    # With the disparity step off, disparities of zero reach the vote of the tracks as points at infinity.
    with np.errstate(all="ignore"):
        return apply(sequence, landmarks.repairs(configuration.parse(RepairConfig, tree)))


def _withdrawn(finding: Finding, left: int, of: int) -> Finding:
    """Finding without the proposal of a step that drops or cuts tracks."""
    dropping = [path for path in finding.proposal if path.removeprefix(_REPAIR) in _DROPPING]
    if not dropping:
        return finding
    reason = f"not proposed: with it the repairs would leave {left} of {of} observations"
    return replace(
        finding,
        text=f"{finding.text}; {reason}",
        proposal={path: value for path, value in finding.proposal.items() if path not in dropping},
        unknown={**finding.unknown, **dict.fromkeys(dropping, reason)},
    )


def _as_configured(sequence: Sequence, repair: RepairConfig) -> Sequence:
    """Sequence with the configured disparity offset and clock."""
    for step in (repair.disparity_offset, repair.clock):
        if step is not None:
            sequence = step.apply(sequence)
    return sequence


def _check_motion(cut: Sequence, config: Config, book: _Book) -> None:
    """Check what takes the camera's own motion to see."""
    repair = config.data.repair
    # The rates of turn tell the clock under almost any reading of the mounting, and the mounting asks for the
    # clock: where that has to move, the mounting is read again.
    mount, reading, series = mounting.check_mounting(cut, repair)
    voted = Consensus().apply(mounting.mounted(cut, reading))
    agreed = SingleObservations().apply(voted)
    pairs = continuations(agreed)
    fits = rigid_fits(agreed, pairs)
    if len(fits) < _FEWEST_FRAMES:
        _motion_unseen(cut, config, len(fits), book)
        return
    clock = book.enter(*motion.check_clock(agreed, motion.vision_steps(agreed, fits), repair))
    if clock.verdict == "fault":
        cut = Clock(offset=clock.measured[0].value).apply(cut)
        mount, reading, series = mounting.check_mounting(cut, repair)
    book.enter(mount, series)
    timed = replace(agreed, rig=mounting.mounted(cut, reading).rig, clock_offset=cut.clock_offset)
    arm, reading = check_lever_arm(cut, timed, fits, reading)
    book.enter(arm)
    timed = replace(timed, rig=mounting.mounted(cut, reading).rig)
    third = book.enter(motion.check_third_component(timed, motion.vision_steps(timed, fits), repair))
    if _levelled(third, repair):
        timed = NavigationFrameVelocity().apply(timed)
    axes = book.enter(check_rate_axes(timed, motion.vision_steps(timed, fits), repair))
    timed = _about_body_axes(timed, axes, repair)
    told, series = stereo.check_stereo(timed, repair)
    for finding in told:
        book.enter(finding, series)
    _check_levels(_mended_stereo(timed, told, repair), fits, config, book)
    book.enter(pixels.check_moving(voted, consensus=repair.consensus is not None))


def _check_tracks(cut: Sequence, config: Config, book: _Book) -> None:
    """Check the noise of the tracks by themselves, where no twist predicts their motion."""
    voted = Consensus().apply(replace(cut, twist=np.zeros_like(cut.twist)))
    agreed = SingleObservations().apply(voted)
    fits = rigid_fits(agreed, continuations(agreed))
    if len(fits) < _FEWEST_FRAMES:
        return
    _check_pixels(agreed, fits, config, book)
    book.enter(pixels.check_moving(voted, consensus=config.data.repair.consensus is not None))


def _check_pixels(sequence: Sequence, fits: dict[int, RigidFit], config: Config, book: _Book) -> None:
    """Check the noise levels of the tracks."""
    noise = config.noise
    book.enter(
        *pixels.check_pixel_noise(
            sequence, fits, pixel_sigma_px=noise.pixel_sigma_px, drift_px=noise.drift_px
        )
    )
    book.enter(stereo.check_match(sequence, fits, matching_bias_px=noise.matching_bias_px))


def _levelled(third: Finding, repair: RepairConfig) -> bool:
    """Whether the third velocity component is to be read as the vertical velocity."""
    path = "data.repair.navigation_frame_velocity"
    return bool({**third.settings, **third.proposal}.get(path, repair.navigation_frame_velocity is not None))


def _about_body_axes(sequence: Sequence, axes: Finding, repair: RepairConfig) -> Sequence:
    """Sequence with the rates as they are to be read."""
    step = repair.navigation_frame_rates
    for value in axes.proposal.values():
        step = None if value is None else configuration.parse(NavigationFrameRates, value)
    return sequence if step is None else step.apply(sequence)


def _mended_stereo(sequence: Sequence, told: list[Finding], repair: RepairConfig) -> Sequence:
    """Sequence with the baseline and the disparities that are proposed."""
    proposal = {path: value for finding in told for path, value in finding.proposal.items()}
    baseline, offset = proposal.get("data.repair.baseline"), proposal.get("data.repair.disparity_offset")
    if baseline is not None:
        sequence = Baseline(metres=baseline["metres"]).apply(sequence)
    if offset is not None:
        # What is configured has been taken out already.
        applied = 0.0 if repair.disparity_offset is None else repair.disparity_offset.pixels
        sequence = DisparityOffset(pixels=offset["pixels"] - applied).apply(sequence)
        sequence = sequence.select(sequence.disparity > 0)
    return sequence


def _check_levels(sequence: Sequence, fits: dict[int, RigidFit], config: Config, book: _Book) -> None:
    """Check biases and noise levels, of the inertial samples and of the tracks."""
    noise = config.noise
    if any(finding.check in _STEREO and finding.proposal for finding in book.found):
        fits = rigid_fits(sequence, continuations(sequence))
    steps = motion.vision_steps(sequence, fits)
    book.enter(biases.check_biases(sequence, steps, bias_mean=noise.bias_mean, bias_sigma=noise.bias_sigma))
    white = book.enter(
        motion.check_inertial_noise(sequence, density=noise.twist_density, seen=(sequence, steps))
    )
    _check_pixels(sequence, fits, config, book)
    measured = {**white.settings, **white.proposal}
    book.enter(
        *check_shared_errors(
            sequence,
            fits,
            density=measured.get("noise.twist_density", noise.twist_density),
            bias_mean=noise.bias_mean,
            bias_sigma=noise.bias_sigma,
            priors={name: value for name, value in asdict(noise).items() if isinstance(value, float)},
        )
    )
    means, _ = sequence.step_means()
    book.series |= {
        "step_time": sequence.stamp[steps.frame] - sequence.stamp[0],
        "step_inertial": means[steps.frame],
        "step_seen": steps.twist,
    }


def _motion_unseen(cut: Sequence, config: Config, frames: int, book: _Book) -> None:
    """Report what single steps do not constrain, and what all steps together determine."""
    repair, noise = config.data.repair, config.noise
    levelled = repair.navigation_frame_velocity is not None
    third = None if levelled else motion.third_component_unseen(cut)
    levelled = levelled or (third is not None and _levelled(third, repair))
    if repair.navigation_frame_rates is not None:
        cut = repair.navigation_frame_rates.apply(cut)
    voted = Consensus().apply(NavigationFrameVelocity().apply(cut) if levelled else cut)
    error = twist_error(inertial_pairs(voted))
    told = _TOLD_TOGETHER if error is not None else ()
    untold = [path for path in _NEEDS_MOTION if path not in told]
    text = f"only {frames} frames have tracks enough to see their motion: "
    text += (
        "all together tell the biases and who leaves the rest, no more"
        if told
        else "nothing more can be told"
    )
    unknown = dict.fromkeys(untold, f"not looked at: only {frames} frames show the camera's motion")
    book.enter(Finding("motion", "unclear", text, unknown=unknown))
    if third is not None:
        book.enter(third)
    if error is not None:
        priors = {"bias_mean": noise.bias_mean, "bias_sigma": noise.bias_sigma}
        book.enter(biases.check_biases_of_few(voted, error, **priors))
        book.enter(pixels.check_moving(voted, consensus=repair.consensus is not None))
    book.enter(motion.check_inertial_noise(cut, density=noise.twist_density, heave=levelled))


BARE_REPAIR = {"duplicated_tracks": False, "disparity": False, "consensus": False}
"""Section ``data.repair`` with the steps switched off that are on by default."""


def bare_tree(name: str, file: str) -> dict[str, Any]:
    """Config of a bare file as plain data: nothing is repaired, so that every trap is found."""
    return {"name": name[:LONGEST_NAME], "data": {"file": file, "repair": dict(BARE_REPAIR)}}


def unrepaired(config: Config) -> Config:
    """Config that reads the data as it stands."""
    nothing = dict.fromkeys(config.data.repair.__dataclass_fields__)
    return replace(config, data=replace(config.data, repair=replace(config.data.repair, **nothing)))
