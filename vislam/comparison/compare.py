"""One comparison from config to results: open the data, run the estimators, save, publish."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from vislam.base.errors import ConfigError, DataError, DivergedError, Interrupted
from vislam.base.files import check_writable, folder_name
from vislam.base.progress import Progress
from vislam.base.types import Array, BoolArray
from vislam.checks.judge import read_checklist
from vislam.comparison import config as configuration
from vislam.comparison.bounding import drive_bound, refuse_unbounded
from vislam.comparison.config import LIST_MAKER, Config
from vislam.comparison.considering import Given, considered, refuse_doubled, wanted
from vislam.comparison.identity import code_digest, combine, inputs_digest
from vislam.comparison.inertia import inertia, started
from vislam.comparison.job import Job
from vislam.comparison.keeping import FolderKeeper, Keeper, NoKeeper
from vislam.comparison.members import Member, Unbuilt, list_makers, members
from vislam.comparison.open import Dataset, open_dataset, require_usable
from vislam.comparison.provenance import provenance
from vislam.comparison.results import (
    PLACES,
    RECORD,
    SCHEMA_VERSION,
    Described,
    Published,
    Results,
    announce,
    publish,
    read_spread,
)
from vislam.comparison.running import Runner
from vislam.core.estimator import Estimator, Problem, VerticalVelocityNoise
from vislam.core.lagged import Lags
from vislam.core.observation_set import CommonSet
from vislam.core.record import Record, Tracks
from vislam.core.run import Run
from vislam.datasets.find import search_path
from vislam.evaluation.held_out import hold_out
from vislam.models import Kernel, TrackNoise, independent_sigma
from vislam.models.odometry import MotionNoise

_ID_DIGITS = 10
"""Digits of the hash in the name of a results folder."""


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
    config_dir: Path | None = None,
    allow_substitute: bool,
    progress: Progress,
    against: Path | None = None,
    tolerance: float = 0.05,
    report: bool = True,
    fresh: bool = False,
    processes: int = 1,
    at_a_time: int = 1,
) -> Outcome:
    """Run a comparison and write ``out/<id>/``.

    The id is a hash of the config, the data and the code, so that a rerun lands in the same place. Each run
    is written when it has ended; a later start runs those that are missing or incomplete, or all if it is to
    start ``fresh``. The checks of the config are judged; ``against`` names saved results for them, which no
    error may exceed by more than the share ``tolerance`` if they say nothing else of them. ``report`` says
    whether a page is wanted. ``processes`` share the further runs of ``consider`` and ``sandwich``;
    ``at_a_time`` estimators run at the same time, each in a process of its own.

    Raises
    ------
    ConfigError, DataError
        Before anything is written.
    DivergedError
        If an estimator that the list of observations is to come from is incomplete.
    """
    members(config)
    checklist = read_checklist(config, against=against, tolerance=tolerance, schema_version=SCHEMA_VERSION)
    dataset = open_dataset(
        config.data,
        seed=config.seed,
        data_dir=data_dir,
        config_dir=config_dir,
        allow_substitute=allow_substitute,
        held_out=config.held_out,
    )
    checklist.refuse_other(digest=dataset.sequence.digest, reference=dataset.reference)
    identity = identify(config, dataset, folders=search_path(data_dir, config_dir=config_dir))
    folder = out / result_id(config, identity)
    for file in PLACES:
        check_writable(folder / file)
    keeper = FolderKeeper(folder, fresh=fresh)
    again = (folder / "metrics.json").is_file()
    keeper.clear()
    prepared = prepare(config, dataset, progress, keeper=keeper, identity=identity)
    if not fresh:
        prepared = replace(prepared, record=earlier_provenance(prepared.record, folder))
    Results(config, prepared.record, {}).begin(folder)
    results = replace(prepared.run(processes, at_a_time=at_a_time), spread=read_spread(folder))
    for line in told_of_rerun(keeper.found, tuple(results.runs), again=again):
        progress.note(line)
    published = publish(results, folder, checklist, report=report)
    announce(results, published, progress)
    return Outcome(folder, results, published)


def told_of_rerun(kept: Sequence[str], runs: Sequence[str], *, again: bool) -> list[str]:
    """What became of what an earlier start had left: kept, run again, overwritten; nothing without one.

    Parameters
    ----------
    kept, runs : sequence of str
        Names of the runs that were found, and of all.
    again : bool
        Whether there were results before.
    """
    told = []
    if kept:
        told.append(f"kept from an earlier start (--fresh runs them again): {', '.join(kept)}")
    computed = [name for name in runs if name not in kept]
    if computed and (kept or again):
        told.append(f"computed {'again' if again else 'now'}: {', '.join(computed)}")
    if again:
        told.append("overwritten: metrics.json, and the page with its figures")
    return told


def keep(results: Results, out: Path, *, report: bool) -> Path:
    """Write results that were had without a folder to one of their own below ``out``; return it.

    Runs are kept with them; what was read from files is there already.

    Raises
    ------
    DataError
        If it cannot be written.
    """
    identity = combine(configuration.dump(results.config), results.record.digest, code_digest())
    folder = out / result_id(results.config, identity)
    for file in PLACES:
        check_writable(folder / file)
    keeper = FolderKeeper(folder)
    if isinstance(results.config, Config):
        results.begin(folder)
        for run in results.runs.values():
            keeper.keep(run)
    checklist = read_checklist(results.config, against=None, tolerance=0.0, schema_version=SCHEMA_VERSION)
    publish(results, folder, checklist, report=report)
    return folder


@dataclass(frozen=True)
class Prepared:
    """A comparison that is ready to run.

    Attributes
    ----------
    config : Config
    record : Record
    runner : Runner
    estimators : dict of str to Estimator or Unbuilt
        By the name of their run, in order.
    problem : Problem
        What each of them was built from, but for gate and kernel.
    """

    config: Config
    record: Record
    runner: Runner
    estimators: Mapping[str, Estimator | Unbuilt]
    problem: Problem

    def run(self, processes: int = 1, *, at_a_time: int = 1) -> Results:
        """Run the estimators; one that fails is marked, and the others run all the same.

        ``processes`` share what is run for covariances beside the estimators' own, and ``at_a_time``
        estimators run at the same time.
        """
        runs, interrupted = self.runner.run_all(
            self.estimators,
            common_set=self.record.common_set,
            gates_from=self.config.gates_from,
            job=self._job,
            at_a_time=at_a_time,
        )
        if wanted(self.config) and not interrupted:
            interrupted = self._consider(runs, processes)
        return Results(self.config, self.record, runs, interrupted)

    def _job(self, name: str, usable: BoolArray) -> Job:
        common_set, runner = self.record.common_set, self.runner
        bound = common_set is not None and name not in common_set.exempt
        problem = gateless(self.problem) if bound else self.problem
        section, threads = self.config.estimators[name], self.config.blas_threads
        return Job(name, section, problem, runner.sequence, runner.sigma, usable, threads)

    def _consider(self, runs: dict[str, Run], processes: int) -> bool:
        """Replace runs by those with covariances beside their own, and say whether it was interrupted."""
        runner, common_set, by = self.runner, self.record.common_set, self.config.gates_from
        usable = {
            name: runner.given(name, runs, names=tuple(runs), common_set=common_set, gates_from=by)
            for name in runs
        }
        given = Given(self.config, self.problem, runner.sequence, runner.sigma)
        found = considered(runs, given, usable=usable, processes=processes, progress=runner.progress)
        try:
            for run in found:
                runner.keeper.keep(run)
                runs[run.name] = run
        except Interrupted:
            return True
        return False


def prepare(
    config: Config,
    dataset: Dataset,
    progress: Progress,
    *,
    keeper: Keeper | None = None,
    identity: str = "",
) -> Prepared:
    """Build the estimators of a config, and the common list of observations if there is to be one.

    Parameters
    ----------
    config : Config
    dataset : Dataset
    progress : Progress
    keeper : Keeper, optional
        Keeps each run as soon as it has ended; None: nothing is written.
    identity : str
        Hash of config, data and code.

    Raises
    ------
    ConfigError, DataError
        Before anything runs.
    DivergedError
        If an estimator that the list of observations is to come from is incomplete.
    """
    require_usable(dataset)
    refuse_unbounded(config)
    dataset, kept_back = _parted(config, dataset)
    # Of what every estimator is given, and of nothing that is held out.
    dataset = started(config, dataset)
    found = members(config)
    refuse_doubled(config, make_problem(config, dataset))
    estimators = build_estimators(config, dataset, found, listed=bool(config.common_set_from))
    for note in dataset.notes:
        progress.note(note)
    sigma = pixel_sigma(config, dataset)
    runner = Runner(
        dataset.sequence,
        sigma,
        config.blas_threads,
        progress,
        NoKeeper() if keeper is None else keeper,
        identity,
    )
    common_set = None
    if config.common_set_from:
        makers = list_makers(config, found)
        # Each with a problem of its own, and of the list nobody asks for more than what was fused.
        plain = replace(config, lags=())
        gating = {name: maker.build(make_problem(plain, dataset)) for name, maker in makers.items()}
        exempt = tuple(name for name, member in found.items() if member.takes_all)
        try:
            common_set = runner.freeze(gating, by=config.common_set_from, exempt=exempt)
        except (ConfigError, DivergedError) as failure:
            # What nobody asked for stops no run that was asked for.
            if config.common_set_from != (LIST_MAKER,):
                raise
            progress.note(f"{failure}; each run is given all observations and gates for itself")
            estimators = build_estimators(config, dataset, found)
    given = Tracks.of(dataset.sequence, sigma)
    bound = drive_bound(config, dataset, given)
    record = replace(_record(dataset, given, kept_back, common_set=common_set), bound=bound)
    return Prepared(config, record, runner, estimators, make_problem(config, dataset))


def run_comparison(config: Config, dataset: Dataset, progress: Progress) -> Results:
    """Run the estimators of a config on what of the data is not held out; nothing is written.

    Raises
    ------
    ConfigError, DataError
        Before anything runs.
    DivergedError
        If an estimator that the list of observations is to come from is incomplete.
    Interrupted
        On Ctrl-C or SIGTERM.
    """
    results = prepare(config, dataset, progress).run()
    if results.interrupted:
        raise Interrupted
    return results


def build_estimators(
    config: Config, dataset: Dataset, found: Mapping[str, Member], *, listed: bool = False
) -> dict[str, Estimator | Unbuilt]:
    """Build the estimators of a comparison, in order; a ConfigError names a wrong option.

    Where observations are ``listed``, nobody that is given the list gates for itself.

    Each has a problem of its own, so that none can change what another was given.
    """
    built = {}
    for name, member in found.items():
        problem = make_problem(config, dataset)
        # Who is given all observations does as it is told.
        if listed and not member.takes_all:
            problem = gateless(problem)
        built[name] = member.build(problem)
    return built


def gateless(problem: Problem) -> Problem:
    """Return the problem of an estimator that is given the common observation set, and gates nothing."""
    return replace(problem, gate_probability=1.0)


def _parted(config: Config, dataset: Dataset) -> tuple[Dataset, Tracks]:
    """Dataset of what every estimator is given, and the tracks that none is.

    Of a dataset that was opened whole, they are chosen now.
    """
    given, kept_back = dataset.sequence, dataset.held_out
    if kept_back is None:
        held = hold_out(given.track, share=config.held_out.share, seed=config.held_out.seed)
        given, kept_back = given.select(~held), given.select(held)
    sigma = pixel_sigma(config, replace(dataset, sequence=kept_back))
    strip = None if dataset.strip is None else dataset.strip.of_given(given.row, kept_back.row)
    return replace(dataset, sequence=given, held_out=kept_back, strip=strip), Tracks.of(kept_back, sigma)


def _record(dataset: Dataset, given: Tracks, kept_back: Tracks, *, common_set: CommonSet | None) -> Record:
    """The record of the sequence, to be saved beside its runs."""
    sequence = dataset.sequence
    return Record(
        name=sequence.name,
        synthetic=sequence.synthetic,
        digest=sequence.digest,
        notes=dataset.notes,
        counts={
            **sequence.counts,
            "held_out_tracks": len(np.unique(kept_back.track)),
            "held_out_observations": len(kept_back.track),
        },
        repairs=sequence.repairs,
        stamp=sequence.stamp,
        step_twist=sequence.step_means()[0],
        rig=sequence.rig,
        given=given,
        held_out=kept_back,
        reference=dataset.reference,
        common_set=common_set,
        provenance=provenance(),
        strip=dataset.strip,
    )


def make_problem(config: Config, dataset: Dataset) -> Problem:
    """Build the problem that all estimators are given; ConfigError if the data lack what it is to use."""
    noise = config.noise
    if noise.vertical_velocity is not None and not np.isfinite(dataset.sequence.vertical_velocity).any():
        raise ConfigError(
            f"noise.vertical_velocity: {dataset.sequence.name} has no vertical velocity; set it to null, or "
            "switch data.repair.navigation_frame_velocity on if the third velocity component is one"
        )
    return Problem(
        rig=dataset.sequence.rig.copy(),
        noise=MotionNoise(
            np.array(noise.twist_density),
            np.array(noise.bias_walk),
            None if noise.acceleration_density is None else np.array(noise.acceleration_density),
        ),
        first_pose_sigma=np.array(noise.first_pose_sigma),
        bias_mean=np.array(noise.bias_mean),
        bias_sigma=np.array(noise.bias_sigma),
        track_noise=_track_noise(config),
        gate_probability=config.gate_probability,
        camera_rotation_sigma=noise.camera_rotation_sigma,
        disparity_offset_sigma=noise.disparity_offset_sigma_px,
        principal_point_sigma=noise.principal_point_sigma_px,
        focal_scale_sigma=noise.focal_scale_sigma,
        clock_sigma=noise.clock_sigma,
        velocity_direction_sigma=noise.velocity_direction_sigma,
        shared_walk=noise.shared_walk.densities(),
        vertical_velocity=None
        if noise.vertical_velocity is None
        else VerticalVelocityNoise(noise.vertical_velocity.walk, noise.vertical_velocity.tilt_sigma),
        kernel=None if config.kernel is None else Kernel(config.kernel.degrees_of_freedom),
        lags=Lags(config.lags, config.lag_cov_every) if config.lags else None,
        kept=config.data.landmarks.most,
        imu=inertia(config, dataset) if config.motion == "imu" else None,
    )


def pixel_sigma(config: Config, dataset: Dataset) -> Array:
    """Standard deviation of (uL, uR, v), ``(n, 3)`` [px], of independent noise."""
    sequence = dataset.sequence
    disparity = sequence.disparity
    return independent_sigma(
        _track_noise(config),
        age=sequence.age(),
        disparity=disparity,
        first_disparity=disparity[sequence.first_rows()],
    )


def _track_noise(config: Config) -> TrackNoise:
    """Noise of the tracks; the tracker goes on between keyframes, and so does its drift."""
    drift = config.noise.drift_px * float(np.sqrt(config.data.keyframe_every))
    return TrackNoise(config.noise.pixel_sigma_px, drift, config.noise.matching_bias_px)


def identify(config: Config, dataset: Dataset, *, folders: list[Path]) -> str:
    """Hash of config, data, code with its versions, and of all files that the config names."""
    inputs = inputs_digest(asdict(config), folders)
    parts = [configuration.dump(config), dataset.sequence.digest, code_digest(), inputs]
    return hashlib.sha256("|".join(parts).encode()).hexdigest()


def result_id(config: Described, identity: str) -> str:
    """Name of the results folder: that of the config, and the beginning of the hash."""
    return f"{folder_name(config.name)}-{identity[:_ID_DIGITS]}"


def earlier_provenance(record: Record, folder: Path) -> Record:
    """Record with the date and machine of an earlier start in the same folder, if there was one."""
    try:
        earlier = Record.load(folder / RECORD)
    except DataError:
        return record
    return replace(record, provenance=earlier.provenance)
