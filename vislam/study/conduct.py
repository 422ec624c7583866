"""A study from its config to its table: the missing trials are run, the finished ones are kept."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from vislam import config as configuration
from vislam.comparison import build_estimators, code_digest, provenance
from vislam.config import Config, parse
from vislam.data.source import open_dataset
from vislam.errors import ConfigError
from vislam.report.study_ablation import short_table
from vislam.report.study_labels import errors
from vislam.report.study_page import write_study_page
from vislam.study.ablation import CASE, Ablation, slug
from vislam.study.cluster import LOST, Cluster, run_trials
from vislam.study.folder import StudyFolder
from vislam.study.points import Point, Trial, all_points, all_trials
from vislam.study.settings import StudyConfig
from vislam.study.summary import HEADER, rows_of
from vislam.study.trial import DONE, FAILED
from vislam.study.trials import Trials
from vislam.terminal import Terminal

SCHEMA_VERSION = 1
_ID_DIGITS = 10


@dataclass(frozen=True)
class Plan:
    """What a study consists of.

    Attributes
    ----------
    config : Config
    study : StudyConfig
    points : sequence of Point
    data : str
        Hash of the recording; empty for drives that each trial simulates with its seed.
    about : str
        What the trials are of.
    """

    config: Config
    study: StudyConfig
    points: Sequence[Point]
    data: str
    about: str

    @classmethod
    def of(cls, config: Config) -> "Plan":
        """Plan the study of a config; ConfigError if there is none, or what it sweeps cannot be."""
        if config.study is None:
            raise ConfigError("study: the config has no such section; see configs/monte_carlo.yaml for one")
        study = config.study
        config, data, about = _settle_data(config, seeds=study.seeds)
        return cls(config, study, all_points(config, study), data, about)

    def trials(self) -> Iterator[Trial]:
        """Every seed at every point."""
        first = self.config.seed
        return all_trials(
            self.points, seeds=range(first, first + self.study.seeds), code=code_digest(), data=self.data
        )

    @property
    def simulated(self) -> bool:
        """Whether no recorded data is used."""
        return self.config.data.file is None and self.config.data.packaged is None

    @property
    def id(self) -> str:
        """Hash of config and code; with more seeds a study goes on, so they do not count."""
        lasting = replace(self.config, seed=0, study=replace(self.study, seeds=1, metrics=()))
        text = json.dumps(asdict(lasting)) + code_digest() + self.data
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
    return _conclude(plan, folder, terminal)


def _run_missing(plan: Plan, folder: StudyFolder, cluster: Cluster, terminal: Terminal, number: int) -> None:
    """Run the ``number`` trials that have no result yet."""
    missing = (trial for trial in plan.trials() if folder.find(trial) is None)
    with cluster.connect() as client:
        terminal.note(_address(client))
        with terminal.progress("trials", number) as bar:
            for finished, (trial, result) in enumerate(run_trials(client, missing), start=1):
                folder.save(trial, result)
                bar.update(0, completed=finished)  # type: ignore[arg-type]


def _address(client: Any) -> str:
    """Where to watch the workers: the dashboard needs bokeh, which nothing else does."""
    if find_spec("bokeh") is not None and client.dashboard_link:
        return f"dashboard: {client.dashboard_link}"
    return f"scheduler: {client.scheduler.address}"


def _write_cases(plan: Plan, folder: StudyFolder) -> None:
    """Write the config of each case, so that each can be run on its own."""
    for point in plan.points:
        config = replace(parse(Config, point.tree), name=f"{plan.config.name}-{slug(point.values[CASE])}")
        folder.write_text(folder.path / "cases" / f"{config.name}.yaml", configuration.dump(config))


def _settle_data(config: Config, *, seeds: int) -> tuple[Config, str, str]:
    """Config whose data every trial finds, the hash of its recording if it has one, and what it is."""
    file, packaged = config.data.file, config.data.packaged
    if packaged is not None:
        return (
            config,
            "",
            f"MADE ODOMETRY: real stereo tracks of {packaged.name}, odometry of each trial's seed",
        )
    if file is None:
        return config, "", "SIMULATED: every trial is a simulated drive"
    dataset = open_dataset(config.data, seed=config.seed)
    if dataset.sequence.stand_in:
        # Each worker would decide for itself what it stands in for.
        made = replace(config.data, file=None, inertial=None, reference=None)
        return replace(config, data=made), "", dataset.notes[0]
    if seeds > 1:
        raise ConfigError(
            f"study.seeds: {file} is the same with every seed; set it to 1, or data.file to null, got {seeds}"
        )
    reference = dataset.reference
    known = "no reference" if reference is None else f"reference {reference.name}: {reference.limits}"
    return config, dataset.sequence.digest, f"RECORDED: every trial is of {file}; {known}"


def _conclude(plan: Plan, folder: StudyFolder, terminal: Terminal) -> int:
    """Write ``trials.csv`` and ``study.json``, show the table, and count the lost trials."""
    swept = tuple(plan.points[0].values)
    folder.write_table(plan.trials(), swept=swept, metrics=plan.study.metrics)
    records = [
        {"seed": trial.seed, "point": trial.point.values, **found}
        for trial in plan.trials()
        if (found := folder.find(trial)) is not None
    ]
    counts = Counter(record["status"] for record in records)
    lost = len(plan.points) * plan.study.seeds - len(records)
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
    title = f"vislam {plan.config.name}" + (" [SIMULATED]" if plan.simulated else "")
    trials = Trials.of_records(records)
    ablation = Ablation(tuple(plan.study.defects)) if plan.study.defects else None
    if ablation is not None and errors(trials):
        table = short_table(trials, ablation)
        terminal.rows(table.header, table.rows, title=title)
        _write_cases(plan, folder)
    else:
        terminal.rows(HEADER, rows_of(trials), title=title)
    write_study_page(
        folder.path / "study.html",
        title=title,
        trials=trials,
        notes=(plan.about,),
        ablation=ablation,
        config=configuration.dump(plan.config),
        provenance="\n".join(f"{key}: {value}" for key, value in document["provenance"].items()),
    )
    if lost:
        terminal.note(f"{lost} trials were lost with their workers; run the study again to repeat them")
    terminal.note(f"trials: {folder.path / 'trials.csv'}")
    terminal.note(f"study: {folder.path / 'study.html'}")
    return lost
