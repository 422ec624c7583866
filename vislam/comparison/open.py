"""From a config's data section to a repaired sequence and its reference."""

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from vislam import repair
from vislam.base.errors import DataError
from vislam.comparison.config import DataConfig, HeldOutConfig, InertialConfig, PackagedConfig
from vislam.comparison.plausibility import Implausible, implausible
from vislam.comparison.redraw import redraw, redrawn_note
from vislam.comparison.simulated import simulated_drive
from vislam.core.reference import Reference, truth_reference
from vislam.core.sequence import Repair, Sequence
from vislam.datasets.course_npz import load_course_npz
from vislam.datasets.find import find_file, find_path, not_found, search_path
from vislam.datasets.kitti00 import load_kitti00
from vislam.datasets.oxts import with_oxts
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
    """

    sequence: Sequence
    reference: Reference | None
    notes: tuple[str, ...]
    implausible: tuple[Implausible, ...] = ()
    held_out: Sequence | None = None


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
    allow_stand_in: bool = True,
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
    allow_stand_in : bool
        Whether a missing recording may be replaced by the config's simulation.
    held_out : HeldOutConfig, optional
        Tracks, as the front end has them, that are kept out of the sequence and of its repairs; None: the
        sequence has all.

    Raises
    ------
    DataError
        If the recording, or the path of a simulation, is missing and may not be replaced, or cannot be used.
    """
    if config.packaged is not None:
        return _packaged(config, config.packaged, seed, held_out)
    folders = search_path(data_dir, config_dir=config_dir)
    path = None if config.file is None else find_file(config.file, folders)
    if path is not None:
        return _redrawn(_recorded(config, path, folders, held_out), config, seed)
    if config.file is not None and (not allow_stand_in or config.simulation is None):
        raise DataError(not_found(config.file, folders))
    return _simulated(config, seed, folders, held_out)


def _recorded(config: DataConfig, path: Path, folders: list[Path], held_out: HeldOutConfig | None) -> Dataset:
    sequence = load_course_npz(path)
    if config.inertial is not None:
        sequence = _with_inertial(sequence, config.inertial, [path.parent, *folders])
    wrong = _implausible(sequence, config)
    sequence, kept_back = _parted(sequence, config, held_out)
    if config.reference is None:
        note = "no reference: errors cannot be measured"
        return Dataset(sequence, None, (note,), wrong, kept_back)
    found = find_file(config.reference.file, [path.parent, *folders])
    if found is None:
        note = f"reference {config.reference.file} not found: runs are compared with each other only"
        _log.warning(note)
        return Dataset(sequence, None, (note,), wrong, kept_back)
    reference = load_reference(
        found, config.reference, imu_T_cam=sequence.rig.imu_T_cam, stamp=sequence.stamp
    )
    return Dataset(sequence, reference, (), wrong, kept_back)


def _redrawn(dataset: Dataset, config: DataConfig, seed: int) -> Dataset:
    """The same with inertial data drawn anew, if the config says so."""
    if config.redraw_inertial is None:
        return dataset
    if dataset.reference is None:
        assert config.reference is not None
        raise DataError(
            f"{config.reference.file}: not found, but data.redraw_inertial takes the motion from it; put it "
            "beside the recording, or leave redraw_inertial out"
        )
    drawn = [
        None if part is None else redraw(part, dataset.reference, config.redraw_inertial, seed=seed)
        for part in (dataset.sequence, dataset.held_out)
    ]
    assert drawn[0] is not None
    note = redrawn_note(dataset.sequence.name, dataset.reference.name)
    return replace(dataset, sequence=drawn[0], held_out=drawn[1], notes=(note, *dataset.notes))


def _implausible(sequence: Sequence, config: DataConfig) -> tuple[Implausible, ...]:
    """What is implausible of a recording as read, with the baseline that the config may give it.

    The other repairs trust the units: under wrong ones they cut all tracks, and nothing would be left to see.
    """
    baseline = config.repair.baseline
    return tuple(implausible(sequence if baseline is None else baseline.apply(sequence)))


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


def _packaged(
    config: DataConfig, packaged: PackagedConfig, seed: int, held_out: HeldOutConfig | None
) -> Dataset:
    raw, reference = load_kitti00(
        gyro_sigma=packaged.gyro_sigma, velocity_sigma=packaged.velocity_sigma, seed=seed
    )
    note = (
        "MADE ODOMETRY: the stereo tracks are real, KITTI odometry 00; they have no inertial data, so the "
        f"twist is that of their visual odometry with noise added, {packaged.gyro_sigma:g} rad/s and "
        f"{packaged.velocity_sigma:g} m/s. The reference is the {reference.name}, {reference.limits}"
    )
    sequence, kept_back = _parted(raw, config, held_out)
    return Dataset(sequence, reference, (note,), held_out=kept_back)


def _simulated(config: DataConfig, seed: int, folders: list[Path], held_out: HeldOutConfig | None) -> Dataset:
    assert config.simulation is not None
    wanted = config.file
    name = "simulation" if wanted is None else f"synthetic substitute for {wanted}"
    raw, truth = simulated_drive(config.simulation, seed=seed, name=name, folders=folders)
    sequence, kept_back = _parted(raw, config, held_out)
    track, first = np.unique(sequence.track, return_index=True)
    points = truth.points_world[sequence.row[first]]
    notes = (f"SIMULATED: {name}, no recorded data was used",)
    _log.warning(notes[0])
    reference = truth_reference(truth.world_T_imu, track, points, bias=truth.bias)
    return Dataset(sequence, reference, notes, held_out=kept_back)


def _parted(
    raw: Sequence, config: DataConfig, held_out: HeldOutConfig | None
) -> tuple[Sequence, Sequence | None]:
    """Repaired sequence of what is given, and of the tracks that are held out.

    Repairs let tracks vote, on stale frames and on the rigid motion of a frame, so those that are held out
    are chosen before: the given ones are repaired as if there were no others. The held-out ones are cut by
    the vote of all, and none of their pieces is given; those too short to be scored are dropped.
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
    sequence = repair.apply(sequence, config.repair)
    counts = {
        **sequence.counts,
        "landmarks": len(np.unique(sequence.track)),
        "observations": sequence.observations,
    }
    _log.info("%s: %s", sequence.name, ", ".join(f"{key} {value}" for key, value in counts.items()))
    return replace(sequence, counts=counts)


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
