"""A study from its config to its table: the missing trials are run, the finished ones are kept."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from vislam.base.errors import DivergedError
from vislam.base.files import folder_name
from vislam.base.progress import Progress
from vislam.base.settings import LONGEST_NAME
from vislam.comparison import config as configuration
from vislam.comparison.config import Config, parse
from vislam.comparison.provenance import provenance
from vislam.evaluation.metric import ESTIMATE_TITLES
from vislam.study.ablation import CASE, slug
from vislam.study.answers import COVERAGE, NEES
from vislam.study.cluster import LOST, Cluster, run_trials, watch_at
from vislam.study.connection import WorkersGone
from vislam.study.folder import StudyFolder, told
from vislam.study.page.ablation import DETAILS, short_table
from vislam.study.page.labels import ERRORS, TIME, errors
from vislam.study.page.limits import BOUND, bound_table, keys_of_lags
from vislam.study.page.page import write_study_page
from vislam.study.page.tables import CLAIMS, ranking_table
from vislam.study.plan import Plan
from vislam.study.pooled import judge_pooled
from vislam.study.summary import header, reason_line, reasons_of, rows_of
from vislam.study.trial import DONE, FAILED
from vislam.study.trials import Trials

SCHEMA_VERSION = 1
_STARTS = 4
"""How often workers of this machine are started, the first time included."""
_SHOWN = frozenset((*ERRORS, *DETAILS, *CLAIMS, *BOUND, TIME, NEES, COVERAGE))
"""Metrics that the table and the page look at: a trial has hundreds, and each costs memory."""


def conduct(config: Config, *, out: Path, cluster: Cluster, progress: Progress) -> int:
    """Run what is missing of a study, write its table and return the exit code.

    It is 1 if trials were lost, else 3 if a check of the config does not hold on the drives of a point
    together.

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
    progress.note(f"{total} trials, {total - missing} of them are finished")
    if folder.refused:
        progress.note(
            f"{len(folder.refused)} files of trials are not taken, as they are not whole or say that they "
            "are of another trial; these trials run again"
        )
    if missing:
        _run_missing(plan, folder, cluster, progress, missing)
    # Errors of 1e200 m, of runs that blew up, have an infinite mean.
    with np.errstate(over="ignore", invalid="ignore"):
        lost = conclude(plan, folder, progress)
        return 1 if lost else 0 if check(plan, folder, progress) else 3


def check(plan: Plan, folder: StudyFolder, progress: Progress) -> bool:
    """Judge the checks of the config at each point, write them, and say whether all hold."""
    if not plan.config.checks:
        return True
    verdicts = []
    for point in plan.points:
        trials = [trial for trial in plan.trials() if trial.point is point]
        judged = judge_pooled(plan.config, (found for _, found in folder.finished(trials)))
        if point.label:
            progress.note(point.label)
        for verdict in judged:
            progress.note(verdict.line())
        verdicts += [{"point": point.values, **verdict.record()} for verdict in judged]
    folder.write_json(folder.path / "checks.json", verdicts)
    return all(verdict["holds"] for verdict in verdicts)


def _run_missing(plan: Plan, folder: StudyFolder, cluster: Cluster, progress: Progress, number: int) -> None:
    """Run the ``number`` trials that have no result yet, as far as there are workers for them."""
    seen: set[str] = set()
    lost = False
    for start in range(_STARTS):
        try:
            with cluster.connect() as client:
                progress.note(watch_at(client))
                missing = (
                    trial
                    for trial in plan.longest_first().trials()
                    if trial.id not in seen and folder.find(trial) is None
                )
                running = run_trials(client, missing, patience=cluster.patience, say=progress.note)
                with progress.bar("trials", number) as bar:
                    for trial, result in running:
                        folder.save(trial, result)
                        seen.add(trial.id)
                        if result["status"] == LOST and not lost:
                            lost = True
                            progress.note(
                                f"lost, the first: seed {trial.seed}: {reason_line(result['reason'])}"
                            )
                        bar.done(len(seen))
            return
        except WorkersGone as gone:
            last = not cluster.local or start == _STARTS - 1
            what = "what has finished is kept" if last else f"starting others ({start + 1} of {_STARTS - 1})"
            progress.note(f"{gone}; {what}")
            if last:
                return


def conclude(plan: Plan, folder: StudyFolder, progress: Progress) -> int:
    """Write ``trials.csv`` and ``study.json``, show the table, and count the lost trials.

    Raises
    ------
    DivergedError
        If there are trials and no estimator has finished in any of them.
    """
    swept = tuple(plan.points[0].values)
    values = {path: [point.values[path] for point in plan.points] for path in swept}
    tables = folder.write_table(plan.trials, swept=values, metrics=plan.study.metrics)
    counts: Counter[str] = Counter()
    ranking = plan.study.ranking
    ranked = () if ranking is None else (ranking.by, *ranking.errors)
    trials = Trials.of_records(
        _records(plan, folder, counts), keys=_SHOWN.union(ranked, keys_of_lags(plan.config.lags))
    )
    trials = replace(trials, upright=plan.upright)
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
    title = f"vislam {plan.config.name}" + (" [SIMULATED]" if plan.simulated else "")
    _show(plan, trials, progress, title=title)
    if plan.ablation is not None:
        _write_cases(plan, folder)
    page = folder.path / "study.html"
    with told(page):
        write_study_page(
            page,
            title=title,
            trials=trials,
            notes=(plan.about,),
            config=configuration.dump(plan.config),
            provenance="\n".join(f"{key}: {value}" for key, value in document["provenance"].items()),
            ablation=plan.ablation,
            ranking=ranking,
        )
    if lost:
        progress.note(
            f"{lost} trials were lost with their workers, or there was none left for them; run the study "
            "again to repeat them"
        )
    progress.note(f"trials: {', '.join(map(str, tables))}")
    progress.note(f"study: {page}")
    if len(trials) and not trials.any_complete:
        first = next(filter(None, trials.reason))
        raise DivergedError(
            f"no estimator has finished in any of {len(trials)} trials; the first: {reason_line(first)}"
        )
    return lost


def _show(plan: Plan, trials: Trials, progress: Progress, *, title: str) -> None:
    """Print the table, if it has a number, and why trials failed."""
    for line in reasons_of(trials):
        progress.note(line)
    if not trials.any_complete:
        return
    if plan.ablation is not None and errors(trials):
        table = short_table(trials, plan.ablation)
        progress.rows(table.header, table.rows, title=title)
    else:
        for estimate in trials.estimates:
            rows = rows_of(trials.of(estimate))
            progress.rows(header(trials), rows, title=f"{title}, {ESTIMATE_TITLES[estimate]}")
    for estimate in trials.estimates:
        table = bound_table(trials.of(estimate))
        if table.rows:
            progress.rows(table.header, table.rows, title=f"against the bound, {ESTIMATE_TITLES[estimate]}")
    if plan.study.ranking is not None:
        table = ranking_table(trials, plan.study.ranking)
        progress.rows(table.header, table.rows, title="ranks of the runs of a seed")


def _records(plan: Plan, folder: StudyFolder, counts: Counter[str]) -> Iterator[dict[str, Any]]:
    """Finished trials one after the other, whose statuses are counted on the way."""
    for trial, found in folder.finished(plan.trials()):
        counts[found["status"]] += 1
        yield {"seed": trial.seed, "point": trial.point.values, **found}


def _write_cases(plan: Plan, folder: StudyFolder) -> None:
    """Write the config of each case, so that each can be run on its own."""
    for point in plan.points:
        case = f"{plan.config.name}-{slug(point.values[CASE])}"
        config = replace(parse(Config, point.tree), name=case[:LONGEST_NAME])
        folder.write_text(folder.path / "cases" / f"{folder_name(case)}.yaml", configuration.dump(config))
