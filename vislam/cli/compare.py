"""``python -m vislam.compare``: run estimators on identical information, score and report.

Each run is saved when it has ended. The same command resumes from what is there; --fresh starts over.
Exit codes: 0 done, and all checks hold; 1 an estimator failed (what it had done is kept and marked, and the
others are scored); 2 bad config or data, or saved results of other data; 3 no estimator failed, but a check
does not hold; 130 interrupted by Ctrl-C or SIGTERM (what had finished is kept, scored and reported).
"""

import argparse
import os
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from vislam.base.errors import ConfigError
from vislam.cli.command import (
    Parser,
    add_check_options,
    add_config_options,
    answer,
    begin,
    load_config,
    refuse_bad_check_options,
)
from vislam.cli.recording import add_choice_options, add_front_end_option, choice_of, located


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    if (options.data is None) == (options.config is None):
        parser.error("a config is required, or --data with a recording: give one of them")
    return answer(lambda: _compare(options), verbose=options.verbose)


def _parser() -> Parser:
    parser = Parser(prog="python -m vislam.compare", description=__doc__)
    add_config_options(parser, required=False)
    add = parser.add_argument
    add(
        "--data",
        type=Path,
        metavar="PATH",
        help="a folder of stereo images, a bag, or a file of tracks, in place of a config: one is made, "
        "printed and saved in --out",
    )
    add_choice_options(parser)
    add_front_end_option(parser)
    add("--out", type=Path, default=Path("results"), help="folder of the results (default: results)")
    add("--estimators", help="comma-separated names, in place of the config's")
    add_check_options(parser)
    add(
        "--jobs",
        type=int,
        default=1,
        metavar="N",
        help="estimators that run at the same time, each in a process of its own, with the same results but "
        "for time and memory, which the report marks (default: 1, so that each has the machine for itself)",
    )
    add("--fresh", action="store_true", help="run again what an earlier start of the same has finished")
    add(
        "--robustness",
        action="store_true",
        help="repeat it over other held-out tracks and settings nearby; the verdict uses the spread",
    )
    add(
        "--workers",
        type=int,
        help="number of processes of --robustness, and of the config's consider and sandwich (default: "
        "one for each CPU)",
    )
    add("--dump-config", action="store_true", help="print the effective configuration and stop")
    return parser


def _compare(options: argparse.Namespace) -> int:
    # Heavy imports follow the parsing, so that --help and a mistyped key answer at once.
    from vislam.comparison import config as configuration  # noqa: PLC0415

    refuse_bad_check_options(options)
    if options.data is not None:
        from vislam.cli.own_data import config_of  # noqa: PLC0415

        options.config = config_of(
            located(options.data),
            out=options.out,
            choice=choice_of(options),
            front_end=options.front_end,
        )
    if not options.dump_config:
        begin(f"compare {options.config}")
    config = load_config(options)
    if options.estimators:
        names = [name.strip() for name in options.estimators.split(",") if name.strip()]
        chosen = {name: config.estimators.get(name, {}) for name in names}
        config = _with_estimators(config, chosen)
    if options.dump_config:
        print(configuration.dump(config), end="")
        return 0
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.comparison.compare import compare  # noqa: PLC0415
    from vislam.comparison.considering import wanted  # noqa: PLC0415
    from vislam.comparison.results import conclude  # noqa: PLC0415

    if options.jobs < 1:
        raise ConfigError(
            f"--jobs is the number of estimators that run at the same time, 1 or more; got {options.jobs}"
        )
    if options.workers is not None and (options.workers < 1 or not (options.robustness or wanted(config))):
        raise ConfigError(
            "--workers is the number of processes of --robustness, and of the config's consider and "
            f"sandwich, 1 or more; got {options.workers}"
        )
    outcome = compare(
        config,
        out=options.out,
        data_dir=options.data_dir,
        config_dir=options.config.parent,
        allow_substitute=not options.no_substitute,
        progress=Terminal(),
        against=options.against,
        tolerance=options.tolerance,
        report=not options.no_report,
        fresh=options.fresh,
        processes=options.workers or len(os.sched_getaffinity(0)),
        at_a_time=options.jobs,
    )
    if options.robustness and not outcome.results.interrupted:
        outcome = _robust(outcome, options)
    return conclude(
        outcome.results, outcome.published, junit=options.junit, rerun=options.rerun, png=options.png
    )


def _robust(outcome: Any, options: argparse.Namespace) -> Any:
    """The outcome with what the settings do to its errors, written again."""
    from vislam.checks.judge import read_checklist  # noqa: PLC0415
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.comparison.results import SCHEMA_VERSION, headline_of, publish  # noqa: PLC0415
    from vislam.datasets.find import search_path  # noqa: PLC0415
    from vislam.evaluation.evaluate import headline  # noqa: PLC0415
    from vislam.study.robustness import measure_spread  # noqa: PLC0415

    results, progress = outcome.results, Terminal()
    reference = results.record.reference
    spread = measure_spread(
        results.config,
        outcome.folder,
        "held_out_median" if reference is None else headline(reference),
        folders=search_path(options.data_dir, config_dir=options.config.parent),
        workers=options.workers,
        progress=progress,
    )
    checklist = read_checklist(
        results.config, against=options.against, tolerance=options.tolerance, schema_version=SCHEMA_VERSION
    )
    results = replace(results, spread=spread)
    published = publish(results, outcome.folder, checklist, report=not options.no_report)
    for sentence in headline_of(results, published.evaluation):
        progress.note(sentence)
    progress.note(f"{published.path.stem}: {published.path}")
    return replace(outcome, results=results, published=published)


def _with_estimators(config: Any, estimators: dict[str, dict[str, Any]]) -> Any:
    """Choose estimators, and report how many checks of others that leaves out."""
    from vislam.comparison import config as configuration  # noqa: PLC0415

    chosen = configuration.with_estimators(config, estimators)
    left_out = len(config.checks) - len(chosen.checks)
    if left_out:
        print(
            f"{left_out} of {len(config.checks)} checks need estimators that do not run, and are left out",
            file=sys.stderr,
        )
    return chosen


if __name__ == "__main__":
    sys.exit(main())
