"""One comparison from config to results: open the data, run the estimators, save, publish."""

import hashlib
import platform
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import entry_points, version
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from vislam import config as configuration
from vislam.checks.judge import read_checklist
from vislam.config import Config
from vislam.data.source import Dataset, open_dataset
from vislam.errors import ConfigError, DataError
from vislam.estimator import GROUP, ClimbNoise, Estimator, Problem
from vislam.evaluation.held_out import hold_out
from vislam.files import check_writable, folder_name
from vislam.frozen import FrozenList
from vislam.members import members
from vislam.motion import MotionNoise
from vislam.record import Record, Tracks
from vislam.results import PLACES, SCHEMA_VERSION, Published, Results, announce, publish
from vislam.running import Runner
from vislam.sensors import TrackNoise, independent_sigma
from vislam.terminal import Terminal
from vislam.types import Array, BoolArray

_ID_DIGITS = 10


@dataclass(frozen=True)
class Outcome:
    """What a comparison came to."""

    folder: Path
    results: Results
    published: Published


def compare(
    config: Config,
    *,
    out: Path,
    data_dir: Path | None,
    allow_stand_in: bool,
    terminal: Terminal,
    against: Path | None = None,
    tolerance: float = 0.05,
    report: bool = True,
) -> Outcome:
    """Run a comparison and write ``out/<id>/``.

    The id is a hash of the config, the data and the code, so that a rerun lands in the same place. The checks
    of the config are judged; ``against`` names saved results for them, which no error may exceed by more than
    the share ``tolerance`` if they say nothing else of them. ``report`` says whether a page is wanted.

    Raises
    ------
    ConfigError, DataError
        Before anything is written.
    DivergedError
        The same, if an estimator that the list of observations is to come from is incomplete.
    """
    members(config)
    checklist = read_checklist(config, against=against, tolerance=tolerance, schema_version=SCHEMA_VERSION)
    dataset = open_dataset(config.data, seed=config.seed, data_dir=data_dir, allow_stand_in=allow_stand_in)
    checklist.refuse_other(digest=dataset.sequence.digest, reference=dataset.reference)
    folder = out / result_id(config, dataset)
    for file in PLACES:
        check_writable(folder / file)
    results = run_comparison(config, dataset, terminal)
    results.save(folder)
    published = publish(results, folder, checklist, report=report)
    announce(results, published, terminal)
    return Outcome(folder, results, published)


def run_comparison(config: Config, dataset: Dataset, terminal: Terminal) -> Results:
    """Run the estimators of a config on what of the data is not held out; nothing is written.

    Raises
    ------
    ConfigError, DataError
        Before anything runs.
    DivergedError
        If an estimator that the list of observations is to come from is incomplete.
    """
    if dataset.sequence.observations == 0:
        raise DataError(f"{dataset.sequence.name}: no stereo observation is left after the repairs")
    estimators = build_estimators(config, dataset)
    for note in dataset.notes:
        terminal.note(note)
    sigma = pixel_sigma(config, dataset)
    held = hold_out(dataset.sequence.track, share=config.held_out.share, seed=config.held_out.seed)
    runner = Runner(dataset.sequence.select(~held), sigma[~held], config.blas_threads, terminal)
    frozen = None
    if config.frozen_by:
        frozen = runner.freeze(members(config), make_problem(config, dataset), by=config.frozen_by)
    runs = runner.run_all(estimators, frozen=frozen, gates_from=config.gates_from)
    return Results(config, _record(dataset, sigma, held=held, frozen=frozen), runs)


def build_estimators(config: Config, dataset: Dataset) -> dict[str, Estimator]:
    """Build the estimators by the name of their run, in order; a ConfigError names a wrong option."""
    problem = make_problem(config, dataset)
    # Who is given a frozen list does not gate; who is given all observations does as it is told.
    listed = replace(problem, gate_probability=1.0) if config.frozen_by else problem
    return {
        name: member.build(problem if member.takes_all else listed)
        for name, member in members(config).items()
    }


def _record(dataset: Dataset, sigma: Array, *, held: BoolArray, frozen: FrozenList | None) -> Record:
    """What is to be kept of the drive; ``held (n,)`` are the observations that no estimator was given."""
    whole = dataset.sequence
    given, kept_back = (Tracks.of(whole.select(mask), sigma[mask]) for mask in (~held, held))
    return Record(
        name=whole.name,
        stand_in=whole.stand_in,
        digest=whole.digest,
        notes=dataset.notes,
        counts={
            **whole.counts,
            "held_out_tracks": len(np.unique(kept_back.track)),
            "held_out_observations": int(np.count_nonzero(held)),
        },
        repairs=whole.repairs,
        stamp=whole.stamp,
        rig=whole.rig,
        given=given,
        held_out=kept_back,
        reference=dataset.reference,
        frozen=frozen,
        provenance=provenance(),
    )


def make_problem(config: Config, dataset: Dataset) -> Problem:
    """Build the problem that all estimators are given; ConfigError if the data lack what it is to use."""
    noise = config.noise
    if noise.climb is not None and not np.isfinite(dataset.sequence.climb_rate).any():
        raise ConfigError(
            f"noise.climb: {dataset.sequence.name} has no climb rate; set it to null, or switch "
            "data.repair.levelled_velocity on if the third velocity component is one"
        )
    return Problem(
        rig=dataset.sequence.rig,
        noise=MotionNoise(np.array(noise.twist_density), np.array(noise.bias_walk)),
        first_pose_sigma=np.array(noise.first_pose_sigma),
        bias_mean=np.array(noise.bias_mean),
        bias_sigma=np.array(noise.bias_sigma),
        track_noise=_track_noise(config),
        gate_probability=config.gate_probability,
        clock_sigma=noise.clock_sigma,
        disparity_offset_sigma=noise.disparity_offset_sigma_px,
        climb=None if noise.climb is None else ClimbNoise(noise.climb.walk, noise.climb.tilt_sigma),
    )


def pixel_sigma(config: Config, dataset: Dataset) -> Array:
    """Standard deviation of (uL, uR, v), ``(n, 3)`` [px], for whoever takes it as independent noise."""
    sequence = dataset.sequence
    disparity = sequence.disparity
    return independent_sigma(
        _track_noise(config),
        age=sequence.age(),
        disparity=disparity,
        first_disparity=disparity[sequence.first_rows()],
    )


def _track_noise(config: Config) -> TrackNoise:
    return TrackNoise(config.noise.pixel_sigma_px, config.noise.drift_px, config.noise.match_px)


def result_id(config: Config, dataset: Dataset) -> str:
    """Hash of config, data and code version."""
    parts = [configuration.dump(config), dataset.sequence.digest, code_digest()]
    return f"{folder_name(config.name)}-{hashlib.sha256('|'.join(parts).encode()).hexdigest()[:_ID_DIGITS]}"


def provenance() -> dict[str, str]:
    """When, on what and with which versions something was computed."""
    packages = ("vislam", "gtsam", "numpy", "scipy")
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "cpu": _cpu(),
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
        "code": code_digest(),
    }


def _cpu() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


@cache
def code_digest() -> str:
    """Hash of the source, that of all estimators included, so that changed code gets a folder of its own."""
    packages = {__package__, *(entry.value.partition(".")[0] for entry in entry_points(group=GROUP))}
    digest = hashlib.sha256()
    for package in sorted(packages):
        found = find_spec(package)
        for folder in [] if found is None else sorted(found.submodule_search_locations or []):
            for path in sorted(Path(folder).rglob("*.py")):
                digest.update(path.read_bytes())
    return digest.hexdigest()[:_ID_DIGITS]
