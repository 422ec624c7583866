"""``python -m vislam.study``: repeat a comparison over seeds and values of its config, on many processes.

A study that was stopped goes on where it was. Exit codes: 0 every trial has run, and those that failed are
rows of the table; 1 trials were lost with their workers; 2 bad config, workers or folder; 130 interrupted.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from vislam.command import Parser, add_override_options, answer, load_config
from vislam.errors import ConfigError


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        return answer(lambda: _study(options), verbose=options.verbose)
    except KeyboardInterrupt:
        return 130


def _parser() -> argparse.ArgumentParser:
    parser = Parser(prog="python -m vislam.study", description=__doc__)
    add_override_options(parser)
    add = parser.add_argument
    add("--out", type=Path, default=Path("studies"), help="folder of the studies (default: studies)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, help="number of processes (default: one for each CPU)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="a Dask scheduler that runs, tcp://host:port")
    where.add_argument("--scheduler-file", type=Path, metavar="FILE", help="the file that names it")
    return parser


def _study(options: argparse.Namespace) -> int:
    if options.workers is not None and options.workers < 1:
        raise ConfigError(f"--workers must be at least 1, got {options.workers}")
    config = load_config(options)
    # Heavy imports follow the parsing, so that --help and a mistyped key answer at once.
    from vislam.study.cluster import Cluster  # noqa: PLC0415
    from vislam.study.conduct import conduct  # noqa: PLC0415
    from vislam.terminal import Terminal  # noqa: PLC0415

    lost = conduct(
        config,
        out=options.out,
        cluster=Cluster(options.scheduler, options.scheduler_file, options.workers),
        terminal=Terminal(),
    )
    return 1 if lost else 0


if __name__ == "__main__":
    sys.exit(main())
