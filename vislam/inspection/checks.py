"""All checks in their order: each works on the sequence as mended by what the checks before it have found."""

from dataclasses import dataclass, field, replace

from vislam.config import Config
from vislam.data.sequence import Sequence
from vislam.inspection import motion, mounting, pixels, stereo, tracks
from vislam.inspection.finding import Finding, Inspection
from vislam.repair import RepairConfig
from vislam.repair.consensus import Consensus
from vislam.repair.inertial import Clock, LevelledVelocity
from vislam.repair.pixels import Disparity
from vislam.repair.tracks import Interruptions, SingleSightings, StaleTracks
from vislam.types import Array
from vislam.vision import continuations, rigid_fits

_FEWEST_FRAMES = 20


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
    """Inspect a sequence as its file has it.

    Parameters
    ----------
    raw : Sequence
        With no repair applied.
    config : Config
        What is configured: a check finds a fault where that does not answer what the data shows.
    """
    book = _Book()
    repair = config.data.repair
    book.enter(tracks.check_stamps(raw))
    book.enter(tracks.check_observations(raw, repair))
    book.enter(*tracks.check_stale(raw, repair))
    book.enter(motion.check_inertial_noise(raw, density=config.noise.twist_density))
    cut = Interruptions().apply(StaleTracks().apply(raw))
    book.enter(*tracks.check_track_counts(cut))
    _check_motion(_as_configured(Disparity().apply(cut), repair), config, book)
    return Inspection(raw.name, tuple(book.found), book.series)


def _as_configured(sequence: Sequence, repair: RepairConfig) -> Sequence:
    """Sequence with the configured baseline, disparity offset and clock."""
    for step in (repair.baseline, repair.disparity_offset, repair.clock):
        if step is not None:
            sequence = step.apply(sequence)
    return sequence


def _check_motion(cut: Sequence, config: Config, book: _Book) -> None:
    """Check what takes the camera's own motion to see."""
    repair, noise = config.data.repair, config.noise
    # The rates of turn tell the clock under almost any reading of the mounting, and the mounting asks for the
    # clock: where that has to move, the mounting is read again.
    mount, reading, series = mounting.check_mounting(cut, repair)
    voted = Consensus().apply(mounting.mounted(cut, reading))
    agreed = SingleSightings().apply(voted)
    pairs = continuations(agreed)
    fits = rigid_fits(agreed, pairs)
    if len(fits) < _FEWEST_FRAMES:
        text = f"only {len(fits)} frames have tracks enough to see their motion: nothing more can be told"
        book.enter(Finding("motion", "unclear", text))
        return
    clock = book.enter(*motion.check_clock(agreed, motion.vision_steps(agreed, fits), repair))
    if clock.verdict == "fault":
        cut = Clock(offset=clock.measured[0].value).apply(cut)
        mount, reading, series = mounting.check_mounting(cut, repair)
    book.enter(mount, series)
    timed = replace(agreed, rig=mounting.mounted(cut, reading).rig, clock_offset=cut.clock_offset)
    steps = motion.vision_steps(timed, fits)
    third = book.enter(motion.check_third_component(timed, steps, repair))
    if (repair.levelled_velocity is None) == (third.verdict == "fault"):
        timed = LevelledVelocity().apply(timed)
    book.enter(motion.check_biases(timed, steps, bias_sigma=noise.bias_sigma))
    told, series = stereo.check_stereo(timed, repair)
    for finding in told:
        book.enter(finding, series)
    book.enter(
        *pixels.check_pixel_noise(timed, fits, pixel_sigma_px=noise.pixel_sigma_px, drift_px=noise.drift_px)
    )
    book.enter(pixels.check_moving(voted, consensus=repair.consensus is not None))
    means, _ = timed.step_means()
    book.series |= {
        "step_time": timed.stamp[steps.frame] - timed.stamp[0],
        "step_inertial": means[steps.frame],
        "step_seen": steps.twist,
    }


def unrepaired(config: Config) -> Config:
    """Config that reads the data as it stands."""
    nothing = dict.fromkeys(config.data.repair.__dataclass_fields__)
    return replace(config, data=replace(config.data, repair=replace(config.data.repair, **nothing)))
