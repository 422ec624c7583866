"""Many sequences and systems: each row scored like two files, then one table over all of them.

A row of a sequence is a reference and trajectories; a system that is named several times in a row has been
repeated, and its runs are a distribution. One that cannot be read or matched has failed, which the table
counts.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass

from vislam.base.errors import ConfigError, DataError
from vislam.base.fields import STRICT
from vislam.base.files import check_writable, folder_name, write_text
from vislam.base.progress import Progress
from vislam.base.settings import Title, parse, read
from vislam.checks.judge import read_checklist
from vislam.comparison.results import SCHEMA_VERSION, publish
from vislam.comparison.scoring import ScoringConfig, score_files
from vislam.datasets.settings import MatchingConfig, TrajectoryConfig

_PERCENTILES = (0.0, 50.0, 100.0)
_COLUMNS = ("ate_rmse", "ate_planar_rmse", "ate_sim3_rmse", "kitti_t_rel", "kitti_r_rel", "completion")


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SequenceConfig:
    """A sequence of a suite."""

    sequence: Title
    """Its name."""
    reference: dict[str, Any] | str
    """The reference: a path, or what can be set of one."""
    trajectories: dict[str, Any]
    """By system, a path, what can be set of a trajectory, or a list of these: repeated runs."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class SuiteConfig:
    """Sequences, systems and how they are matched."""

    sequences: tuple[SequenceConfig, ...]
    """The rows."""
    matching: MatchingConfig = MatchingConfig()
    """How rows of trajectories are matched."""
    defaults: dict[str, Any] | None = None
    """What holds of every trajectory that says nothing else, as ``{alignment: sim3}``."""


@dataclass(frozen=True)
class Scored:
    """A run of a system on a sequence.

    Attributes
    ----------
    sequence, system : str
    repeat : int
        From 0.
    values : dict of str to float
        Its metrics.
    error : str
        Why it failed; empty if it did not.
    """

    sequence: str
    system: str
    repeat: int
    values: dict[str, float]
    error: str = ""


def read_suite(path: Path) -> SuiteConfig:
    """Read a suite; its paths are relative to it. A ConfigError says what is wrong with it."""
    config = parse(SuiteConfig, read(path))
    if not config.sequences:
        raise ConfigError(f"{path}: sequences: expected one or more, got none")
    names = [one.sequence for one in config.sequences]
    if len(set(names)) < len(names):
        raise ConfigError(f"{path}: sequences: a name is there twice; choose another")
    below = [
        replace(
            one,
            reference=_placed(_tree(one.reference), path.parent),
            trajectories={
                system: [
                    _placed(_tree(run), path.parent) for run in (runs if isinstance(runs, list) else [runs])
                ]
                for system, runs in one.trajectories.items()
            },
        )
        for one in config.sequences
    ]
    return replace(config, sequences=tuple(below))


def run_suite(suite: SuiteConfig, folder: Path, progress: Progress, *, report: bool) -> int:
    """Score all of it, write ``suite.json`` and a folder for each sequence; return the exit code.

    That is 0 if every run could be scored, 1 otherwise.
    """
    check_writable(folder / "suite.json")
    scored = [
        one
        for sequence in suite.sequences
        for one in score_sequence(suite, sequence, folder / folder_name(sequence.sequence), report=report)
    ]
    table = summary(scored)
    plain = [
        {"sequence": o.sequence, "system": o.system, "repeat": o.repeat, "error": o.error, "values": o.values}
        for o in scored
    ]
    write_text(folder / "suite.json", json.dumps({"runs": plain, "systems": table}, indent=1) + "\n")
    header, rows = drawn(table)
    progress.rows(header, rows, title=f"{len(suite.sequences)} sequences")
    for one in scored:
        if one.error:
            progress.note(f"{one.sequence}, {one.system}, run {one.repeat}: {one.error}")
    progress.note(f"suite: {folder / 'suite.json'}")
    return 1 if any(one.error for one in scored) else 0


def score_sequence(
    suite: SuiteConfig, sequence: SequenceConfig, folder: Path, *, report: bool
) -> list[Scored]:
    """Score the runs of a sequence; one that cannot be is marked, and the others are scored all the same."""
    at = f"sequences.{sequence.sequence}"
    reference = parse(
        TrajectoryConfig, {"name": "reference", **_tree(sequence.reference)}, at=f"{at}.reference"
    )
    systems: dict[str, tuple[str, int]] = {}
    trajectories = []
    for system, runs in sequence.trajectories.items():
        for repeat, run in enumerate(runs):
            name = system if len(runs) == 1 else f"{system} {repeat}"
            own = {**(suite.defaults or {}), **run, "name": name}
            systems[name] = system, repeat
            trajectories.append(parse(TrajectoryConfig, own, at=f"{at}.{system}"))
    config = ScoringConfig(
        name=sequence.sequence,
        reference=reference,
        trajectories=tuple(trajectories),
        matching=suite.matching,
    )
    failed: dict[str, str] = {}
    values: dict[str, dict[str, float]] = {name: {} for name in systems}
    try:
        results = score_files(config, failed=failed)
    except DataError as error:
        # Its reference cannot be read, or none of its trajectories can be scored.
        failed = dict.fromkeys(systems, str(error)) | failed
    else:
        checklist = read_checklist(config, against=None, tolerance=0.0, schema_version=SCHEMA_VERSION)
        with np.errstate(all="ignore"):
            published = publish(results, folder, checklist, report=report)
        for metric in published.evaluation.metrics:
            if metric.estimator in values:
                values[metric.estimator][metric.key] = metric.value
    return [
        Scored(sequence.sequence, system, repeat, values[name], failed.get(name, ""))
        for name, (system, repeat) in systems.items()
    ]


def summary(scored: Sequence[Scored]) -> dict[str, dict[str, Any]]:
    """For each system: runs, failures, completion, and the distribution of each metric over its runs.

    A metric over sequences is the mean of the medians over the repeated runs of each, so that a sequence that
    was run more often counts no more.
    """
    systems: dict[str, dict[str, Any]] = {}
    for system in dict.fromkeys(one.system for one in scored):
        own = [one for one in scored if one.system == system]
        good = [one for one in own if not one.error]
        by_sequence: dict[str, list[Scored]] = {}
        for one in good:
            by_sequence.setdefault(one.sequence, []).append(one)
        metrics = {}
        for key in _COLUMNS:
            medians = [
                float(np.median(values))
                for runs in by_sequence.values()
                if (values := [one.values[key] for one in runs if key in one.values])
            ]
            every = [one.values[key] for one in good if key in one.values]
            if every:
                low, middle, high = np.percentile(every, _PERCENTILES)
                metrics[key] = {
                    "mean_of_medians": float(np.mean(medians)),
                    "least": float(low),
                    "median": float(middle),
                    "most": float(high),
                    "sequences": len(medians),
                }
        systems[system] = {"runs": len(own), "failed": len(own) - len(good), "metrics": metrics}
    return systems


def drawn(table: Mapping[str, Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Header and rows of the table over sequences and runs."""
    header = ["", "failed", "ATE [m]", "least to most", "Sim(3) ATE [m]", "KITTI drift [%]", "completion [%]"]
    rows = []
    for system, one in table.items():
        metrics = one["metrics"]
        ate = metrics.get("ate_rmse") or metrics.get("ate_planar_rmse")
        spread = "-" if ate is None else f"{ate['least']:.3g} to {ate['most']:.3g}"
        columns = [ate, *(metrics.get(key) for key in ("ate_sim3_rmse", "kitti_t_rel", "completion"))]
        told = ["-" if column is None else f"{column['mean_of_medians']:.3g}" for column in columns]
        rows.append([system, f"{one['failed']} of {one['runs']}", told[0], spread, *told[1:]])
    return header, rows


def _several(runs: Any) -> list[Any]:
    return runs if isinstance(runs, list) else [runs]


def _tree(given: Any) -> dict[str, Any]:
    if isinstance(given, str):
        return {"file": given}
    if not isinstance(given, dict):
        raise ConfigError(f"a trajectory: expected a path or a mapping, got {given!r:.80}")
    return given


def _placed(tree: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The same with its paths relative to where the command runs."""
    files = ("file", "times", "frames", "cov", "map")
    return {
        key: str(folder / value) if key in files and isinstance(value, str) else value
        for key, value in tree.items()
    }
