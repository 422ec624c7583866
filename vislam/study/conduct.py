"""A study from its config to its table: the missing trials are run, the finished ones are kept."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from vislam import config as configuration
from vislam.comparison import build_estimators, code_digest, provenance
from vislam.config import Config, parse
from vislam.data.source import open_dataset
from vislam.errors import ConfigError
from vislam.report.study_labels import ERRORS, TIME
from vislam.report.study_page import write_study_page
from vislam.study.answers import COVERAGE, NEES
from vislam.study.cluster import LOST, Cluster, run_trials, watch_at
from vislam.study.folder import StudyFolder, told
from vislam.study.points import Point, Trial, all_points, all_trials
from vislam.study.settings import StudyConfig
from vislam.study.summary import HEADER, rows_of
from vislam.study.trial import DONE, FAILED
from vislam.study.trials import Trials
from vislam.terminal import Terminal

SCHEMA_VERSION = 1
_ID_DIGITS = 10
_SHOWN = frozenset((*ERRORS, TIME, NEES, COVERAGE))
"""Metrics that the table and the page look at: a trial has hundreds, and each costs memory."""


@dataclass(frozen=True)
class Plan:
    """What a study consists of.

    Attributes
    ----------
    config : Config
    study : StudyConfig
    points : sequence of Point
    """

    config: Config
    study: StudyConfig
    points: Sequence[Point]

    @classmethod
    def of(cls, config: Config) -> "Plan":
        """Plan the study of a config; ConfigError if there is none, or what it sweeps cannot be."""
        if config.study is None:
            raise ConfigError("study: the config has no such section; see configs/monte_carlo.yaml for one")
        if config.data.file is not None:
            raise ConfigError(
                f"data.file: trials are of data made with a seed, got {config.data.file}; set it to null"
            )
        return cls(config, config.study, all_points(config, config.study))

    def trials(self) -> Iterator[Trial]:
        """Every seed at every point."""
        first = self.config.seed
        return all_trials(self.points, seeds=range(first, first + self.study.seeds), code=code_digest())

    def longest_first(self) -> "Plan":
        """The same study with its longest drives first: in the end no worker waits long for another's."""
        points = sorted(self.points, key=_frames, reverse=True)
        return replace(self, points=points)

    @property
    def id(self) -> str:
        """Hash of config and code; with more seeds a study goes on, so they do not count."""
        lasting = replace(self.config, seed=0, study=replace(self.study, seeds=1, metrics=()))
        text = json.dumps(asdict(lasting)) + code_digest()
        return f"{self.config.name}-{hashlib.sha256(text.encode()).hexdigest()[:_ID_DIGITS]}"

    def refuse_bad_options(self) -> None:
        """Raise ConfigError or DataError for what would make every trial of a point fail."""
        dataset = open_dataset(parse(Config, self.points[0].tree).data, seed=self.config.seed)
        for point in self.points:
            build_estimators(parse(Config, point.tree), dataset)


def conduct(config: Config, *, out: Path, cluster: Cluster, terminal: Terminal) -> int:
    """Run what is missing of a study, write its table and return how many trials were lost.

    Raises
    ------
    ConfigError, DataError
        If config, workers or folder cannot be used; trials that have finished are kept.
    """
    plan = Plan.of(config)
    plan.refuse_bad_options()
    folder = StudyFolder(out / plan.id)
    total = len(plan.points) * plan.study.seeds
    missing = sum(folder.find(trial) is None for trial in plan.trials())
    terminal.note(f"{total} trials, {total - missing} of them are finished")
    if missing:
        _run_missing(plan, folder, cluster, terminal, missing)
    return conclude(plan, folder, terminal)


def _run_missing(plan: Plan, folder: StudyFolder, cluster: Cluster, terminal: Terminal, number: int) -> None:
    """Run the ``number`` trials that have no result yet."""
    missing = (trial for trial in plan.longest_first().trials() if folder.find(trial) is None)
    with cluster.connect() as client:
        terminal.note(watch_at(client))
        with terminal.progress("trials", number) as bar:
            for finished, (trial, result) in enumerate(run_trials(client, missing), start=1):
                folder.save(trial, result)
                bar.update(0, completed=finished)  # type: ignore[arg-type]


def _frames(point: Point) -> int:
    """Length of a point's drive; 0 for packaged data, of which all points have the same."""
    simulation = point.tree["data"]["simulation"]
    return 0 if simulation is None else int(simulation["frames"])


def conclude(plan: Plan, folder: StudyFolder, terminal: Terminal) -> int:
    """Write ``trials.csv`` and ``study.json``, show the table, and count the lost trials."""
    swept = tuple(plan.points[0].values)
    folder.write_table(plan.trials, swept=swept, metrics=plan.study.metrics)
    counts: Counter[str] = Counter()
    trials = Trials.of_records(_records(plan, folder, counts), keys=_SHOWN)
    lost = len(plan.points) * plan.study.seeds - len(trials)
    document: dict[str, Any] = {
        "schema_version": SCHEMA_VERSION,
        "name": plan.config.name,
        "config": asdict(plan.config),
        "swept": swept,
        "points": len(plan.points),
        "seeds": plan.study.seeds,
        "counts": {DONE: counts[DONE], FAILED: counts[FAILED], LOST: lost},
        "provenance": provenance(),
    }
    folder.write_json(folder.path / "study.json", document)
    title = f"vislam {plan.config.name} [SIMULATED]"
    terminal.rows(HEADER, rows_of(trials), title=title)
    page = folder.path / "study.html"
    with told(page):
        write_study_page(
            page,
            title=title,
            trials=trials,
            notes=("SIMULATED: every trial is a simulated drive",),
            config=configuration.dump(plan.config),
            provenance="\n".join(f"{key}: {value}" for key, value in document["provenance"].items()),
        )
    if lost:
        terminal.note(f"{lost} trials were lost with their workers; run the study again to repeat them")
    terminal.note(f"trials: {folder.path / 'trials.csv'}")
    terminal.note(f"study: {page}")
    return lost


def _records(plan: Plan, folder: StudyFolder, counts: Counter[str]) -> Iterator[dict[str, Any]]:
    """Finished trials one after the other, whose statuses are counted on the way."""
    for trial, found in folder.finished(plan.trials()):
        counts[found["status"]] += 1
        yield {"seed": trial.seed, "point": trial.point.values, **found}
