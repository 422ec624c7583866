"""A results folder: what runs leave in it, and all that is computed from that, now or years later."""

import json
import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

from vislam.base.errors import INTERRUPTED, DataError
from vislam.base.files import write_text
from vislam.base.progress import Progress
from vislam.checks.judge import Checklist, Demanding, Verdict, summary
from vislam.checks.junit import write_junit
from vislam.comparison import config as configuration
from vislam.comparison.keeping import RUNS
from vislam.core.own_clock import OwnClock
from vislam.core.record import Record
from vislam.core.run import Log, Run
from vislam.evaluation import Evaluation, evaluate
from vislam.evaluation.attribution import AblationStep, attribute
from vislam.evaluation.information import SharedInformation, shared_information, unequal_line
from vislam.evaluation.metric import ESTIMATE_TITLES
from vislam.evaluation.shared_errors import estimated_errors
from vislam.evaluation.spread import Spread
from vislam.report.figures import all_figures
from vislam.report.noticed import noticed_lines, read_lines
from vislam.report.page import MOST_CHECKS, Content, clear_report, write_page
from vislam.report.scene import scene_data
from vislam.report.shown import Shown
from vislam.report.svg import plain_svg, save_png, save_svg
from vislam.report.table import MARKS, SHORT, comparison_tables
from vislam.report.top_view import top_view
from vislam.report.verdict import verdict as verdict_of
from vislam.report.words import named

_log = logging.getLogger("vislam")
SCHEMA_VERSION = 2
RECORD = "record.npz"
ROBUSTNESS = "robustness"
"""Name of the file, and of the folder below the results, that hold what the settings do to the errors."""
PLACES = ("metrics.json", "report.html", "runs/a.npz", "list/a.npz", "figures/a.svg")
"""A file of each folder that results are written to, and those that earlier results may have left."""


class Described(Demanding, Protocol):
    """What results are of: a comparison, or trajectory files and their reference."""

    @property
    def name(self) -> str:
        """As it stands in titles."""
        ...

    @property
    def ablation_chain(self) -> dict[str, str]:
        """What each run adds to the one before it."""
        ...


@dataclass(frozen=True)
class Results:
    """What a comparison has done, before anything is made of it.

    Attributes
    ----------
    config : Config or ScoringConfig
    record : Record
    runs : dict of name to Run
        In their order.
    interrupted : bool
        Whether it was stopped before all runs had ended.
    spread : Spread or None
        What choices of the settings do to the errors; None until that has been tried.
    own : mapping of name to OwnClock
        How those from elsewhere are matched with the reference.
    """

    config: Described
    record: Record
    runs: dict[str, Run]
    interrupted: bool = False
    spread: Spread | None = None
    own: Mapping[str, OwnClock] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """Title of tables and figures."""
        mark = " [SIMULATED]" if self.record.synthetic else ""
        return f"vislam {self.config.name}: {self.record.name}{mark}"

    def common_set_line(self) -> str:
        """Description of the common observation set; empty without one."""
        return "" if self.record.common_set is None else self.record.common_set.tell(self._own())

    def timed_line(self) -> str:
        """Which runs' times and memory are not those of a run that had the machine for itself; else empty."""
        beside = {name: run.cost.beside for name, run in self.runs.items() if run.cost.beside}
        if not beside:
            return ""
        others = max(beside.values())
        return (
            f"times and memory of {named(list(beside))} are of processes beside up to {others} other"
            f"{'s' if others > 1 else ''}; --jobs 1 --fresh measures each alone"
        )

    def shared_information(self) -> list[SharedInformation]:
        """What each pair of the comparison's own runs had in common."""
        return shared_information(self._own(), self.record.common_set)

    def not_fused(self) -> dict[str, int]:
        """Observations of the common observation set that each run bound to it did not fuse."""
        return {} if self.record.common_set is None else self.record.common_set.not_fused(self._own())

    def _own(self) -> dict[str, Run]:
        return {
            name: run
            for name, run in self.runs.items()
            if name in self.config.estimators and not run.elsewhere
        }

    def begin(self, folder: Path) -> None:
        """Write what there is before any run: config and record, each whole or not at all."""
        write_text(folder / "config.yaml", configuration.dump(self.config))
        self.record.save(folder / RECORD)

    @classmethod
    def load(cls, folder: Path) -> "Results":
        """Read what a comparison has left, finished or not; DataError if that is nothing.

        An estimator without a saved run counts as one that did not begin.
        """
        path = folder / "config.yaml"
        if not path.is_file():
            raise DataError(
                f"{folder}: expected the results folder of a comparison, got no config.yaml in it; "
                "name the folder that vislam.compare printed"
            )
        config, record = configuration.load(path), Record.load(folder / RECORD)
        runs = {name: _load_run(folder, name, record) for name in config.estimators}
        return cls(config, record, runs, spread=read_spread(folder))


def read_spread(folder: Path) -> Spread | None:
    """What settings nearby do to the errors, if that was tried; DataError if it cannot be read."""
    return Spread.read(folder / f"{ROBUSTNESS}.json")


def _load_run(folder: Path, name: str, record: Record) -> Run:
    path = folder / RUNS / f"{name}.npz"
    if not os.path.lexists(path):
        reason = "not run; run the comparison again to go on with it"
        frames, observations = len(record.stamp), len(record.given.track)
        return Run.without_frames(name, Log(error=reason), frames_expected=frames, observations=observations)
    run = Run.load(path)
    record.refuse_other(run, path=path)
    return run


@dataclass(frozen=True)
class Published:
    """What was made of results.

    Attributes
    ----------
    evaluation : Evaluation
    verdicts : sequence of Verdict
    document : dict
        What ``metrics.json`` holds.
    path : Path
        What to read: the report, or the metrics if there is none.
    """

    evaluation: Evaluation
    verdicts: Sequence[Verdict]
    document: dict[str, Any]
    path: Path


def publish(results: Results, folder: Path, checklist: Checklist, *, report: bool = True) -> Published:
    """Score and judge runs; write ``metrics.json`` and, if wanted, figures and report.

    Nothing but results and checklist enters: whoever reads them from their folder gets the same bytes.
    """
    evaluation = evaluate(results.runs, results.record, results.own)
    verdicts = checklist.judge(results.runs, evaluation)
    steps = attribute(results.config.ablation_chain, results.runs, evaluation, results.record.reference)
    document = metrics_document(results, evaluation, steps, verdicts)
    clear_report(folder)
    written = folder / "metrics.json"
    write_text(written, json.dumps(document, indent=1) + "\n")
    if report:
        written = folder / "report.html"
        _write_report(results, evaluation, steps, verdicts, path=written)
    return Published(evaluation, verdicts, document, written)


def _write_report(
    results: Results,
    evaluation: Evaluation,
    steps: Sequence[AblationStep],
    verdicts: Sequence[Verdict],
    *,
    path: Path,
) -> None:
    """Write the page, and its figures beside it."""
    record, runs = results.record, results.runs
    shown = Shown.of(runs, record, evaluation, steps)
    figures = all_figures(shown)
    for name, drawing in figures.items():
        save_svg(drawing.svg, path.parent / "figures" / f"{name}.svg")
    write_page(
        path,
        Content(
            title=results.title,
            runs=runs,
            record=record,
            evaluation=evaluation,
            steps=steps,
            figures=figures,
            scene=scene_data(shown),
            travelled=shown.travelled(),
            config=configuration.dump(results.config),
            checks=[(verdict.holds, f"{verdict.check}: {verdict.measured}") for verdict in verdicts],
            common_set=results.common_set_line(),
            unequal=unequal_line(results.shared_information()),
            spread=results.spread,
            noticed=[*noticed_lines(results.own), *filter(None, [results.timed_line()])],
        ),
    )


def top_view_svg(results: Results, evaluation: Evaluation) -> str:
    """Paths and maps from above, as an SVG element."""
    return plain_svg(top_view(Shown.of(results.runs, results.record, evaluation, ())))


def metrics_document(
    results: Results, evaluation: Evaluation, steps: Sequence[AblationStep], verdicts: Sequence[Verdict]
) -> dict[str, Any]:
    """Plain data of ``metrics.json``."""
    record, reference, not_fused = results.record, results.record.reference, results.not_fused()
    return {
        "schema_version": SCHEMA_VERSION,
        "name": results.config.name,
        "dataset": {
            "name": record.name,
            "synthetic": record.synthetic,
            "reference": None if reference is None else reference.name,
            "reference_limits": None if reference is None else reference.limits,
            "digest": record.digest,
            "counts": record.counts,
            "repairs": [asdict(step) for step in record.repairs],
            "common_set": None if record.common_set is None else record.common_set.record(),
            "notes": list(record.notes),
        },
        "runs": {
            name: {
                "complete": run.complete,
                "error": run.log.error,
                "estimates": list(run.estimates),
                "degenerate": {one: list(evaluation.degenerate(name, one)) for one in run.estimates},
                "frames": len(run.stamp),
                "counts": run.log.counts,
                "listed_not_fused": not_fused.get(name),
                "events": list(run.log.events),
                "run_beside": run.cost.beside,
            }
            for name, run in results.runs.items()
        },
        "robustness": None if results.spread is None else results.spread.record(),
        "shared_errors": [item.record() for item in estimated_errors(results.runs)],
        "equal_information": [item.record() for item in results.shared_information()],
        "elsewhere": {
            name: {"told": list(one.told), "noticed": list(one.noticed)} for name, one in results.own.items()
        },
        "provenance": dict(record.provenance),
        "metrics": evaluation.records(),
        "statistics": evaluation.statistic_records(),
        "worst_segments": evaluation.worst_segments(),
        "map_agreement": evaluation.map_agreement(),
        "lag": evaluation.lag_records(),
        "attribution": [asdict(step) for step in steps],
        "checks": [verdict.record() for verdict in verdicts],
    }


def headline_of(results: Results, evaluation: Evaluation) -> list[str]:
    """What the terminal shows of the verdict."""
    unequal, reference = unequal_line(results.shared_information()), results.record.reference
    return verdict_of(results.runs, evaluation, reference, unequal=unequal, spread=results.spread).answer


def announce(results: Results, published: Published, progress: Progress) -> None:
    """Print the closing table, where to read on, and what must not be overlooked."""
    unequal = unequal_line(results.shared_information())
    tables = comparison_tables(results.runs, published.evaluation, keys=SHORT, marks=True)
    for estimate, table in tables.items():
        progress.rows(table.header, table.rows, title=f"{results.title}, {ESTIMATE_TITLES[estimate]}")
    progress.note(MARKS)
    for sentence in headline_of(results, published.evaluation):
        progress.note(sentence)
    if told := results.common_set_line():
        progress.note(told)
    for line in filter(None, [unequal, results.timed_line()]):
        progress.note(line)
    for line in (*read_lines(results.own), *noticed_lines(results.own)):
        progress.note(line)
    progress.note(f"{published.path.stem}: {published.path}")
    for name, run in results.runs.items():
        if not run.complete:
            progress.note(f"{name} is incomplete: {run.log.error}")
            _log.info("%s: %s", name, run.log.traceback)
    for name, run in results.runs.items():
        for estimate in run.estimates:
            for reason in published.evaluation.degenerate(name, estimate):
                progress.note(f"{name}, {estimate}, is degenerate and not ranked: {reason}")
    _announce_checks(published.verdicts, progress)


def _announce_checks(verdicts: Sequence[Verdict], progress: Progress) -> None:
    """Print what does not hold, and what holds as long as that is no long list."""
    for verdict in verdicts:
        if not verdict.holds or len(verdicts) <= MOST_CHECKS:
            progress.note(verdict.line())
    if len(verdicts) > 1:
        progress.note(summary(verdicts))


def save_pictures(results: Results, evaluation: Evaluation, folder: Path) -> None:
    """Write the figures as PNG, beside those that the page shows."""
    steps = attribute(results.config.ablation_chain, results.runs, evaluation, results.record.reference)
    for name, drawing in all_figures(Shown.of(results.runs, results.record, evaluation, steps)).items():
        save_png(drawing.figure, folder / "figures" / f"{name}.png")


def conclude(
    results: Results, published: Published, *, junit: Path | None, rerun: Path | None, png: bool = False
) -> int:
    """Write checks as JUnit XML, a Rerun recording and figures as PNG, if wanted; return the exit code."""
    if png:
        save_pictures(results, published.evaluation, published.path.parent)
    if junit is not None:
        write_junit(junit, published.document)
    if rerun is not None:
        # It imports an optional package.
        from vislam.report.recording import write_recording  # noqa: PLC0415

        write_recording(rerun, results.runs, results.record, title=results.title)
    if results.interrupted:
        return INTERRUPTED
    if not all(run.complete for run in results.runs.values()):
        return 1
    return 0 if all(verdict.holds for verdict in published.verdicts) else 3
