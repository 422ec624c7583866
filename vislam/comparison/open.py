"""From a config's data section to a repaired sequence and its reference."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vislam import repair
from vislam.base.errors import DataError
from vislam.base.types import Array
from vislam.comparison.config import (
    DataConfig,
    HeldOutConfig,
    InertialConfig,
    OtherSource,
    PackagedConfig,
    ReferenceAccuracy,
    SimulationSource,
)
from vislam.comparison.plausibility import Implausible, implausible
from vislam.comparison.redraw import redraw, redrawn_note
from vislam.comparison.simulated import simulated
from vislam.core.filled import measured
from vislam.core.reference import Reference
from vislam.core.sequence import Repair, Sequence
from vislam.core.standstill import Standstill
from vislam.core.strip import Strip
from vislam.datasets.find import find_file, find_path, not_found, search_path
from vislam.datasets.oxts import with_oxts
from vislam.datasets.recording import Opening, Recording
from vislam.datasets.registry import read, source_of
from vislam.datasets.settings import Kitti00
from vislam.datasets.trajectories import load_reference
from vislam.evaluation.held_out import FEWEST_VIEWS, hold_out

_log = logging.getLogger("vislam.comparison")


@dataclass(frozen=True)
class Dataset:
    """What a comparison runs on.

    Attributes
    ----------
    sequence : Sequence
        Repaired.
    reference : Reference or None
    notes : tuple of str
        What a reader of the report must know: synthetic substitute, made odometry, missing reference.
    implausible : tuple of Implausible
        What of the data as it was read is off by orders of magnitude.
    held_out : Sequence or None
        Tracks that are kept from every estimator, with ids that the sequence does not have, and without a say
        in its repairs. None: none was chosen when it was opened.
    strip : Strip or None
        Small pictures, where the tracks are of images.
    standstill : Standstill or None
        Where the body stands still, once that is decided.
    """

    sequence: Sequence
    reference: Reference | None
    notes: tuple[str, ...]
    implausible: tuple[Implausible, ...] = ()
    held_out: Sequence | None = None
    strip: Strip | None = None
    standstill: Standstill | None = None


def require_usable(dataset: Dataset) -> None:
    """Raise DataError, in one line, if no estimator can be run on a dataset.

    That is if its units are off by orders of magnitude, or if the repairs have left no observation.
    """
    name = dataset.sequence.name
    if dataset.implausible:
        raise DataError(f"{name}: {dataset.implausible[0]}")
    if dataset.sequence.observations == 0:
        taken = _taken(dataset.sequence)
        raise DataError(f"{name}: no stereo observation is left after the repairs: {taken}")


def open_dataset(
    config: DataConfig,
    *,
    seed: int,
    data_dir: Path | None = None,
    config_dir: Path | None = None,
    allow_substitute: bool = True,
    held_out: HeldOutConfig | None = None,
) -> Dataset:
    """Read or simulate, choose the tracks that are held out, then repair.

    Parameters
    ----------
    config : DataConfig
    seed : int
        Seed of a simulation, and of the noise of packaged data.
    data_dir : Path, optional
        First folder to look for files.
    config_dir : Path, optional
        Folder of the file that the config was loaded from, the next to look for files.
    allow_substitute : bool
        Whether a missing recording may be replaced by the config's simulation.
    held_out : HeldOutConfig, optional
        Tracks, as the front end has them, that are kept out of the sequence and of its repairs; None: the
        sequence has all.

    Raises
    ------
    DataError
        If the recording, or the path of a simulation, is missing and may not be replaced, or cannot be used.
    """
    opening = Opening(search_path(data_dir, config_dir=config_dir), seed)
    raw = open_recording(config, opening, allow_substitute=allow_substitute)
    wrong = () if raw.sequence.synthetic else _implausible(raw.sequence, config)
    sequence, kept_back = _parted(raw.sequence, config, held_out)
    notes = (*raw.notes, *_of_keyframes(sequence, config))
    dataset = Dataset(sequence, _with_landmarks(raw, sequence), notes, wrong, kept_back, raw.strip)
    return dataset if raw.sequence.synthetic else _measured(_redrawn(dataset, config, seed))


def open_recording(config: DataConfig, opening: Opening, *, allow_substitute: bool = True) -> Recording:
    """Read or simulate, with inertial samples and reference from elsewhere if the config says so.

    Raises
    ------
    DataError
        As :func:`open_dataset`.
    """
    name = config.recorded_file
    if config.simulated or (name is not None and _to_substitute(config, name, opening, allow_substitute)):
        return _simulated(config, opening)
    raw, folders = _read(config, opening)
    if config.inertial is not None:
        raw = replace(raw, sequence=_with_inertial(raw.sequence, config.inertial, folders))
    if config.reference is None:
        if raw.reference is not None:
            return replace(raw, reference=_as_accurate(raw.reference, config.reference_accuracy))
        note = "no reference: errors cannot be measured"
        return replace(raw, notes=(*raw.notes, note))
    found = find_file(config.reference.file, folders)
    if found is None:
        note = f"reference {config.reference.file} not found: runs are compared with each other only"
        _log.warning(note)
        return replace(raw, reference=None, points_world=None, notes=(*raw.notes, note))
    reference = load_reference(
        found, config.reference, imu_T_cam=_mounting(raw.sequence, config), stamp=raw.sequence.stamp
    )
    return replace(raw, reference=reference, points_world=None)


def _as_accurate(reference: Reference, known: ReferenceAccuracy | None) -> Reference:
    """Reference with the accuracy that the config knows of it, if it does."""
    if known is None:
        return reference
    return replace(reference, sigma=known.sigma_m, sigma_rotation=float(np.deg2rad(known.sigma_deg)))


def _mounting(sequence: Sequence, config: DataConfig) -> Array:
    """Mounting ``imu_T_cam`` after the repairs, by which a reference of the camera becomes the body's."""
    empty = sequence.select(np.zeros(sequence.observations, bool))
    return repair.apply(empty, config.repairs).rig.imu_T_cam


def _to_substitute(config: DataConfig, name: str, opening: Opening, allowed: bool) -> bool:
    """Whether the simulation stands in for a file that is missing; DataError if it may not."""
    if find_file(name, opening.folders) is not None:
        return False
    if not allowed or config.simulation is None:
        raise DataError(not_found(name, opening.folders))
    return True


def _read(config: DataConfig, opening: Opening) -> tuple[Recording, list[Path]]:
    """Recording of a source, and the folders in which what belongs to it is looked for."""
    folders, name = opening.folders, config.recorded_file
    if name is not None and (path := find_file(name, folders)) is not None:
        folders = [path.parent, *folders]
    match config:
        case DataConfig(packaged=PackagedConfig() as packaged):
            source = Kitti00(gyro_sigma=packaged.gyro_sigma, velocity_sigma=packaged.velocity_sigma)
            return read(source.format, source, opening), folders
        case DataConfig(source=OtherSource() as other):
            return read(other.format, other.options, opening), folders
        case DataConfig(source=None):
            assert name is not None
            known = source_of(opening.find(name))
            return read(known.format, known, opening), folders
    assert config.source is not None
    return read(config.source.format, config.source, opening), folders


def _redrawn(dataset: Dataset, config: DataConfig, seed: int) -> Dataset:
    """The same with inertial data re-sampled, if the config says so."""
    if config.redraw_inertial is None:
        return dataset
    if dataset.reference is None:
        named = dataset.sequence.name if config.reference is None else config.reference.file
        raise DataError(
            f"{named}: no reference found, but data.redraw_inertial takes the motion from it; put it "
            "beside the recording, or leave redraw_inertial out"
        )
    drawn = [
        None if part is None else redraw(part, dataset.reference, config.redraw_inertial, seed=seed)
        for part in (dataset.sequence, dataset.held_out)
    ]
    assert drawn[0] is not None
    note = redrawn_note(dataset.sequence.name, dataset.reference.name)
    return replace(dataset, sequence=drawn[0], held_out=drawn[1], notes=(note, *dataset.notes))


def _measured(dataset: Dataset) -> Dataset:
    """The same with a reference that has only what was measured."""
    if dataset.reference is None:
        return dataset
    reference, remark = measured(dataset.reference, dataset.sequence.stamp)
    return replace(dataset, reference=reference, notes=(*dataset.notes, *filter(None, [remark])))


def _implausible(sequence: Sequence, config: DataConfig) -> tuple[Implausible, ...]:
    """What is implausible of a recording as read, with baseline and units that the config may give it.

    The other repairs trust the units: under wrong ones they cut all tracks, and nothing would be left to see.
    """
    for step in (config.repair.baseline, config.repair.imu_units):
        if step is not None:
            sequence = step.apply(sequence)
    return tuple(implausible(sequence))


def _with_inertial(sequence: Sequence, config: InertialConfig, folders: list[Path]) -> Sequence:
    camera = config.camera_timestamps
    return with_oxts(
        sequence,
        _existing(config.folder, folders),
        camera_timestamps=None if camera is None else _existing(camera, folders),
    )


def _existing(name: str, folders: list[Path]) -> Path:
    found = find_path(name, folders)
    if found is None:
        looked = ", ".join(str(folder) for folder in folders)
        raise DataError(f"{name}: not found in {looked}; put the drive's folder into one of these")
    return found


def _simulated(config: DataConfig, opening: Opening) -> Recording:
    wanted = config.recorded_file
    settings = config.simulation
    if isinstance(config.source, SimulationSource):
        settings = config.source
    assert settings is not None
    raw = simulated(
        settings, opening, name="simulation" if wanted is None else f"synthetic substitute for {wanted}"
    )
    _log.warning(raw.notes[0])
    return raw


def _with_landmarks(raw: Recording, repaired: Sequence) -> Reference | None:
    """Reference with the landmark of each track that the repairs have left, where it is known."""
    reference = raw.reference
    if reference is None or raw.points_world is None:
        return reference
    track, first = np.unique(repaired.track, return_index=True)
    points = raw.points_world[repaired.row[first]]
    known = np.isfinite(points).all(axis=1)
    return replace(reference, track=track[known], points_world=points[known])


def _parted(
    raw: Sequence, config: DataConfig, held_out: HeldOutConfig | None
) -> tuple[Sequence, Sequence | None]:
    """Repaired sequence of what is given, and of the tracks that are held out.

    Repairs let tracks vote, on duplicated frames and on the rigid motion of a frame, so those that are held
    out are chosen before: the given ones are repaired as if there were no others. The held-out ones are cut
    by the vote of all, and none of their pieces is given; those too short to be scored are dropped.
    """
    if held_out is None:
        return _repaired(raw, config), None
    held = hold_out(raw.track, share=held_out.share, seed=held_out.seed)
    given = _repaired(raw.select(~held), config)
    if not held.any():
        return given, raw.select(held)
    whole = repair.apply(raw, config.repair)
    long_enough = np.bincount(whole.track)[whole.track] >= FEWEST_VIEWS
    kept_back = whole.select(held[whole.row] & long_enough)
    first = int(given.track.max(initial=-1)) + 1
    return given, replace(kept_back, track=kept_back.track + first)


def _repaired(sequence: Sequence, config: DataConfig) -> Sequence:
    """Repaired sequence of what is given, with the observations at keyframes alone if that is configured."""
    sequence = repair.apply(sequence, config.repairs)
    if config.keyframe_every > 1:
        sequence = sequence.with_keyframes(config.keyframe_every)
    counts = {
        **sequence.counts,
        "landmarks": len(np.unique(sequence.track)),
        "observations": sequence.observations,
    }
    _log.info("%s: %s", sequence.name, ", ".join(f"{key} {value}" for key, value in counts.items()))
    return replace(sequence, counts=counts)


def _of_keyframes(sequence: Sequence, config: DataConfig) -> list[str]:
    """Note on what is left out between keyframes, if anything is."""
    if sequence.keyframe is None:
        return []
    dropped = sequence.counts["dropped_between_keyframes"]
    return [
        f"KEYFRAMES: one frame in {config.keyframe_every}, {sequence.counts['keyframes']} of "
        f"{len(sequence)}; of {dropped + sequence.observations} observations the {dropped} of frames between "
        "are given to no estimator, and the poses of these frames are predicted by inertia"
    ]


def _taken(sequence: Sequence) -> str:
    """Which steps dropped how many observations, and what they counted."""
    taking = [step for step in sequence.repairs if step.applied and step.after < step.before]
    if not taking:
        return "none was in the recording; look at what its features hold"
    told = ", ".join(
        f"{step.name} dropped {step.before - step.after} of {step.before}{_counted(step)}" for step in taking
    )
    worst = max(taking, key=lambda step: step.before - step.after)
    return f"{told}; python -m vislam.inspect says why, data.repair.{worst.name} switches it"


def _counted(step: Repair) -> str:
    """What a step counted of what it dropped, in brackets."""
    counts = {key: count for key, count in step.counts.items() if key.startswith("dropped") and count}
    listed = ", ".join(
        f"{count} {key.removeprefix('dropped_').replace('_', ' ')}" for key, count in counts.items()
    )
    return f" ({listed})" if listed else ""
