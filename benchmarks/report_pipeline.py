"""The report's figures and its running time beside ours, with the reference that the report did not have.

``python -m benchmarks.report_pipeline --figure docs/report_pipeline.png``
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.report_figure import Panel, beside
from benchmarks.telling import tell
from benchmarks.timing import Part
from vislam.base.errors import ConfigError
from vislam.base.files import check_writable, replace_whole
from vislam.cli.command import answer
from vislam.cli.console import Terminal
from vislam.comparison import config as configuration
from vislam.comparison.compare import run_comparison
from vislam.comparison.config import Config
from vislam.comparison.open import open_dataset
from vislam.comparison.results import Results
from vislam.evaluation import Evaluation, evaluate

QUOTED_S = 60.0
"""What the report says that mapping alone took on its dataset 3, with one feature in twenty [s]."""
TIMED = {
    "mapping_only": ("report", "mapping alone, one feature in twenty"),
    "mapping_only_all": ("report", "mapping alone, all features"),
    "report_ekf": ("report", "full SLAM as the report did it, one feature in twenty"),
    "ekf": ("ours", "full SLAM, all features, filter"),
    "isam2": ("ours", "full SLAM, all features, smoother"),
}
"""Runs that are timed: whose they are, and what job they do."""
FIGURES = (
    ("Fig. 2\ndead reckoning", "dead_reckoning", "dead_reckoning"),
    ("Fig. 4\nmap, poses of dead reckoning", "mapping_only", "isam2"),
    ("Fig. 5\nSLAM, pose gain 0.01", "report_ekf_slowed", "isam2"),
    ("section III-D\nSLAM as printed", "report_ekf", "ekf"),
)
"""What each column shows: the report's run, and the run of ours beside it."""


@dataclass(frozen=True)
class Side:
    """Results of one of the two comparisons."""

    results: Results
    evaluation: Evaluation


def main(arguments: Sequence[str] | None = None) -> int:
    """Run both, print the table, draw the figure, and return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.report_pipeline", description=__doc__)
    add = parser.add_argument
    add("--report", type=Path, default=Path("configs/report_ds3.yaml"), help="config of the report's runs")
    add("--ours", type=Path, default=Path("configs/ds3.yaml"), help="config of ours, on the same drive")
    add("--data-dir", type=Path, help="first folder to look for the recording")
    add("--figure", type=Path, help="file to draw to (.png, .svg, .pdf)")
    add("--out", type=Path, metavar="FILE.json", help="file to write all numbers to")
    options = parser.parse_args(arguments)
    return answer(lambda: _run(options), verbose=False)


def _run(options: argparse.Namespace) -> int:
    for file in (options.out, options.figure):
        if file is not None:
            check_writable(file)
    configs = {"report": options.report, "ours": options.ours}
    loaded = {whose: configuration.load(path) for whose, path in configs.items()}
    for whose, name in _needed():
        if name not in loaded[whose].estimators:
            raise ConfigError(f"{configs[whose]}: expected a run {name} among the estimators; add it")
    sides = {whose: measure(config, data_dir=options.data_dir) for whose, config in loaded.items()}
    tell({"times": lambda: times(sides), "errors": lambda: errors(sides)}, out=options.out)
    if options.figure is not None:
        drawn = beside(
            [
                (
                    panel(sides["report"], one, title=title),
                    panel(sides["ours"], other, title=f"ours\n{other}"),
                )
                for title, one, other in FIGURES
            ]
        )
        with replace_whole(options.figure) as temporary:
            drawn.savefig(temporary, format="png", dpi=110)
    return 0


def _needed() -> set[tuple[str, str]]:
    """Whose which runs are told of."""
    drawn = {("report", one) for _, one, _ in FIGURES} | {("ours", other) for _, _, other in FIGURES}
    return drawn | {(whose, name) for name, (whose, _) in TIMED.items()}


def measure(config: Config, *, data_dir: Path | None) -> Side:
    """Run a comparison; nothing is written."""
    terminal = Terminal()
    results = run_comparison(config, open_dataset(config.data, seed=config.seed, data_dir=data_dir), terminal)
    return Side(results, evaluate(results.runs, results.record))


def times(sides: dict[str, Side]) -> Part:
    """How long each job took, against what the report says of the first."""
    found = {name: sides[whose].results.runs[name].total_time for name, (whose, _) in TIMED.items()}
    rows = [
        [
            job,
            name,
            f"{found[name]:.1f}",
            f"{QUOTED_S / found[name]:.1f}",
            f"{found['report_ekf'] / found[name]:.1f}",
        ]
        for name, (_, job) in TIMED.items()
    ]
    return Part(
        title=f"{_drive(sides)}: running time",
        header=["job", "run", "time [s]", "60 s over it", "report_ekf over it"],
        rows=rows,
        notes=(
            f"the report quotes about {QUOTED_S:g} s for mapping alone with one feature in twenty, on an "
            "unnamed machine; report_ekf forms every matrix over all landmarks so far, as its equations do",
        ),
        values={"seconds": found},
    )


def errors(sides: dict[str, Side]) -> Part:
    """Error and path length of every run."""
    rows, values = [], {}
    for whose, side in sides.items():
        for name, run in side.results.runs.items():
            error = _error(side, name)
            length = side.evaluation.value(name, "path_length")
            state = "" if run.complete else f"stopped at frame {len(run.stamp)}"
            rows.append([whose, name, _told(error, 2), _told(length, 0), state])
            values[f"{whose} {name}"] = {"error_m": error, "path_m": length, "complete": run.complete}
    reference = sides["report"].results.record.reference
    return Part(
        title=f"{_drive(sides)}: error",
        header=["whose", "run", "ATE [m]", "path [m]", ""],
        rows=rows,
        notes=(
            f"planar ATE against {'no reference' if reference is None else reference.name}, rigidly aligned",
        ),
        values=values,
    )


def panel(side: Side, name: str, *, title: str) -> Panel:
    """What a run shows from above, laid on the reference; on dead reckoning's start without one."""
    record, runs = side.results.record, side.results.runs
    error = _error(side, name)
    return Panel.of(
        runs[name].levelled(),
        record.reference,
        beneath=runs["dead_reckoning"].levelled() if name != "dead_reckoning" else None,
        title=title + (f", ATE {error:.3g} m" if error is not None else ""),
    )


def _error(side: Side, name: str) -> float | None:
    return side.evaluation.value(name, "ate_planar_rmse")


def _told(value: float | None, digits: int) -> str:
    return "-" if value is None else f"{value:.{digits}f}"


def _drive(sides: dict[str, Side]) -> str:
    record = sides["report"].results.record
    return f"{record.name} [SIMULATED]" if record.stand_in else record.name


if __name__ == "__main__":
    sys.exit(main())
