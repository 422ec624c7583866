"""How sure the ranking of a comparison is: it is repeated over held-out tracks and over settings nearby."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from vislam.base.files import write_text
from vislam.base.progress import Progress
from vislam.comparison import config as configuration
from vislam.comparison.config import Config, DataConfig
from vislam.comparison.results import ROBUSTNESS
from vislam.core.run import Estimate
from vislam.datasets.find import find_file
from vislam.evaluation.metric import METRICS
from vislam.evaluation.spread import Spread
from vislam.study.cluster import Cluster
from vislam.study.conduct import conduct
from vislam.study.folder import StudyFolder
from vislam.study.plan import Plan

_HELD_OUT = 3
"""Other choices of the held-out tracks."""
_NEARBY = (0.8, 1.4)
"""Thresholds that were set by hand are tried at these multiples of theirs."""
_TAILS = (10.0, 0.1)
"""So is the share of good observations that the gate rejects."""
_LARGEST_TAIL = 0.5


def neighbourhood(config: Config) -> dict[str, tuple[Any, ...]]:
    """What is tried, one at a time, by dotted path: of the settings that a config has switched on."""
    repair = config.data.repair
    around: dict[str, tuple[Any, ...]] = {}
    if config.held_out.share > 0.0:
        seed = config.held_out.seed
        around["held_out.seed"] = tuple(range(seed + 1, seed + 1 + _HELD_OUT))
    for step, key in (("disparity", "minimum_px"), ("consensus", "threshold")):
        section = getattr(repair, step)
        if section and getattr(section, key) > 0.0:
            value = getattr(section, key)
            around[f"data.repair.{step}.{key}"] = tuple(round(value * factor, 6) for factor in _NEARBY)
    tail = 1.0 - config.gate_probability
    tails = [tail * factor for factor in _TAILS if tail * factor < _LARGEST_TAIL]
    around["gate_probability"] = tuple(round(1.0 - one, 12) for one in tails)
    return around


def measure_spread(
    config: Config, folder: Path, key: str, *, folders: list[Path], workers: int | None, progress: Progress
) -> Spread:
    """Run the neighbourhood of a comparison, and write what its errors do to the results folder.

    What has finished is kept below ``folder``, and is not run again by a later start.

    Parameters
    ----------
    config : Config
    folder : Path
        Of the results.
    key : str
        Of the error.
    folders : list of Path
        Where files are looked for.
    workers : int or None
        Processes; None: one for each CPU.
    progress : Progress

    Raises
    ------
    ConfigError, DataError
        If the config or the folder cannot be used.
    """
    swept = {"seeds": 1, "around": neighbourhood(config)}
    study = replace(config, data=_absolute(config.data, folders), checks=(), ablation_chain={}, study=swept)
    below = folder / ROBUSTNESS
    conduct(study, out=below, cluster=Cluster(workers=workers), progress=progress)
    plan = Plan.of(study)
    spread = _spread(plan, StudyFolder(below / plan.id), key)
    write_text(folder / f"{ROBUSTNESS}.json", json.dumps(spread.record(), indent=1) + "\n")
    progress.rows(*spread_rows(spread), title=f"{METRICS[key].label} over {len(spread.points)} settings")
    return spread


def spread_rows(spread: Spread) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """A row for each run and estimate: as configured, and the least and the most of all."""
    digits, rows = METRICS[spread.key].digits, []
    for name, estimate in spread.values:
        own, found = spread.values[name, estimate][0], spread.range_of(name, estimate)
        if found is not None:
            told = ["-" if value is None else f"{value:.{digits}f}" for value in (own, *found)]
            rows.append((name, estimate, *told, f"{found[1] - found[0]:.{digits}f}"))
    return ("estimator", "estimate", "as configured", "least", "most", "spread"), rows


def _spread(plan: Plan, folder: StudyFolder, key: str) -> Spread:
    """Read the trials of a plan, in the order of its points."""
    own = plan.points[0].values
    points, errors = [], []
    for trial in plan.trials():
        changed = {path: value for path, value in trial.point.values.items() if value != own[path]}
        told = ", ".join(f"{path} {configuration.inline(value)}" for path, value in changed.items())
        points.append(told or "as configured")
        found = folder.find(trial)
        errors.append({} if found is None else dict(_errors(found["metrics"], key)))
    names = list(dict.fromkeys(entry for one in errors for entry in one))
    return Spread(key, tuple(points), {entry: tuple(one.get(entry) for one in errors) for entry in names})


def _errors(metrics: list[dict[str, Any]], key: str) -> Iterator[tuple[tuple[str, Estimate], float | None]]:
    for metric in metrics:
        if metric["key"] == key and metric["estimate"] is not None:
            yield (metric["estimator"], metric["estimate"]), metric["value"]


def _absolute(data: DataConfig, folders: list[Path]) -> DataConfig:
    """The same with files by their full paths, so that every process finds them."""
    file = None if data.file is None else find_file(data.file, folders)
    if file is None:
        return data
    reference = data.reference
    if reference is not None:
        beside = find_file(reference.file, [file.parent, *folders])
        if beside is not None:
            reference = replace(reference, file=str(beside.resolve()))
    return replace(data, file=str(file.resolve()), reference=reference)
