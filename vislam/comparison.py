"""One comparison from config to report: open the data, run the estimators, evaluate, write."""

import hashlib
import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from vislam import config as configuration
from vislam.config import Config
from vislam.data.export import write_kitti, write_npz, write_ply, write_tum
from vislam.data.source import Dataset, open_dataset
from vislam.errors import ConfigError, DataError
from vislam.estimator import ClimbNoise, Problem
from vislam.evaluation import Evaluation, evaluate
from vislam.evaluation.attribution import Rung, attribute
from vislam.files import replace_whole
from vislam.frozen import FrozenList
from vislam.members import members
from vislam.motion import MotionNoise
from vislam.report.figures import all_figures
from vislam.report.page import write_page
from vislam.report.scene import scene_data
from vislam.report.shown import Shown
from vislam.report.table import SHORT, comparison_table
from vislam.run import Run
from vislam.running import Runner
from vislam.sensors import TrackNoise, independent_sigma
from vislam.terminal import Terminal
from vislam.types import Array

SCHEMA_VERSION = 1
_ID_DIGITS = 10


@dataclass(frozen=True)
class Outcome:
    """What a comparison came to."""

    folder: Path
    runs: Mapping[str, Run]
    evaluation: Evaluation
    frozen: FrozenList | None


def compare(
    config: Config, *, out: Path, data_dir: Path | None, allow_stand_in: bool, terminal: Terminal
) -> Outcome:
    """Run a comparison and write ``out/<id>/``.

    The id is a hash of the config, the data and the code, so that a rerun lands in the same place.

    Raises
    ------
    ConfigError, DataError
        Before anything is written, but for the folder.
    DivergedError
        The same, if an estimator that the list of observations is to come from is incomplete.
    """
    chosen = members(config)
    dataset = open_dataset(config.data, seed=config.seed, data_dir=data_dir, allow_stand_in=allow_stand_in)
    if dataset.sequence.observations == 0:
        raise DataError(f"{dataset.sequence.name}: no stereo observation is left after the repairs")
    problem = make_problem(config, dataset)
    # Who is given a frozen list does not gate; who is given all observations does as it is told.
    listed = replace(problem, gate_probability=1.0) if config.frozen_by else problem
    estimators = {
        name: member.build(problem if member.takes_all else listed) for name, member in chosen.items()
    }
    for note in dataset.notes:
        terminal.note(note)
    folder = out / result_id(config, dataset)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: results cannot be written there ({error.strerror})") from None
    runner = Runner(dataset.sequence, pixel_sigma(config, dataset), config.blas_threads, terminal)
    frozen = runner.freeze(chosen, problem, by=config.frozen_by) if config.frozen_by else None
    runs = runner.run_all(estimators, frozen=frozen, gates_from=config.gates_from)
    evaluation = evaluate(runs, dataset.reference)
    write_results(folder, config, dataset, runs, evaluation, frozen=frozen)
    table = comparison_table(runs, evaluation, keys=SHORT)
    terminal.table(table, title=_title(config, dataset), path=folder / "report.html")
    if frozen is not None:
        terminal.note(frozen.tell(runs))
    for name, run in runs.items():
        if not run.complete:
            terminal.note(f"{name} is incomplete: {run.error}")
    return Outcome(folder, runs, evaluation, frozen)


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
    parts = [configuration.dump(config), dataset.sequence.digest, _code_digest()]
    return f"{config.name}-{hashlib.sha256('|'.join(parts).encode()).hexdigest()[:_ID_DIGITS]}"


def write_results(
    folder: Path,
    config: Config,
    dataset: Dataset,
    runs: Mapping[str, Run],
    evaluation: Evaluation,
    *,
    frozen: FrozenList | None,
) -> None:
    """Write everything a comparison leaves behind, each file whole or not at all."""
    text = configuration.dump(config)
    with replace_whole(folder / "config.yaml") as temporary:
        temporary.write_text(text, encoding="utf-8")
    for name, run in runs.items():
        run.save(folder / "runs" / f"{name}.npz")
        write_tum(folder / f"{name}.tum", run.stamp, run.world_T_imu)
        write_kitti(folder / f"{name}_kitti.txt", run.world_T_imu)
        write_npz(folder / f"{name}_trajectory.npz", run)
        write_ply(folder / f"{name}.ply", run.points_world)
    made_by = provenance()
    rungs = attribute(config.ladder, runs, evaluation, dataset.reference)
    write_metrics(
        folder / "metrics.json",
        config,
        dataset=dataset,
        runs=runs,
        evaluation=evaluation,
        rungs=rungs,
        frozen=frozen,
        provenance=made_by,
    )
    shown = Shown.of(runs, dataset.reference, evaluation, dataset.sequence)
    figures = all_figures(shown)
    for name, drawing in figures.items():
        with replace_whole(folder / "figures" / f"{name}.png") as temporary:
            drawing.figure.savefig(temporary, format="png", dpi=130)
    write_page(
        folder / "report.html",
        title=_title(config, dataset),
        notes=dataset.notes,
        runs=runs,
        evaluation=evaluation,
        rungs=rungs,
        reference=dataset.reference,
        counts=dataset.sequence.counts,
        repairs=dataset.sequence.repairs,
        frozen="" if frozen is None else frozen.tell(runs),
        figures=figures,
        scene=scene_data(shown),
        provenance="\n".join(f"{key}: {value}" for key, value in made_by.items()),
        config=text,
    )


def write_metrics(
    path: Path,
    config: Config,
    *,
    dataset: Dataset,
    runs: Mapping[str, Run],
    evaluation: Evaluation,
    rungs: Sequence[Rung],
    frozen: FrozenList | None,
    provenance: Mapping[str, str],
) -> None:
    """Write ``metrics.json``."""
    reference = dataset.reference
    not_fused = {} if frozen is None else frozen.not_fused(runs)
    document: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "name": config.name,
        "dataset": {
            "name": dataset.sequence.name,
            "stand_in": dataset.sequence.stand_in,
            "reference": None if reference is None else reference.name,
            "reference_limits": None if reference is None else reference.limits,
            "digest": dataset.sequence.digest,
            "counts": dataset.sequence.counts,
            "repairs": [asdict(step) for step in dataset.sequence.repairs],
            "frozen": None if frozen is None else frozen.record(),
            "notes": list(dataset.notes),
        },
        "runs": {
            name: {
                "complete": run.complete,
                "error": run.error,
                "frames": len(run.stamp),
                "counts": run.counts,
                "listed_not_fused": not_fused.get(name),
                "events": list(run.events),
            }
            for name, run in runs.items()
        },
        "provenance": dict(provenance),
        "metrics": evaluation.records(),
        "attribution": [asdict(rung) for rung in rungs],
    }
    with replace_whole(path) as temporary:
        temporary.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _title(config: Config, dataset: Dataset) -> str:
    mark = " [SIMULATED]" if dataset.sequence.stand_in else ""
    return f"vislam {config.name}: {dataset.sequence.name}{mark}"


def provenance() -> dict[str, str]:
    """When, on what and with which versions something was computed."""
    packages = ("vislam", "gtsam", "numpy", "scipy")
    return {
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "cpu": _cpu(),
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
        "code": _code_digest(),
    }


def _cpu() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _code_digest() -> str:
    """Hash of the package's own source, so that a changed estimator gets a folder of its own."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:_ID_DIGITS]
