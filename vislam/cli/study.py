"""``python -m vislam.study``: repeat a comparison over seeds and values of its config, on many processes.

A study that was stopped goes on where it was. Exit codes: 0 every trial has run, and those that failed are
rows of the table; 1 trials were lost with their workers, or no estimator has finished in any trial; 2 bad
config, workers or folder; 3 a check of the config does not hold over all drives; 130 interrupted.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from vislam.base.errors import ConfigError
from vislam.cli.command import Parser, add_override_options, answer, begin, load_config


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    try:
        return answer(lambda: _study(options), verbose=options.verbose)
    except KeyboardInterrupt:
        return 130


def _parser() -> Parser:
    parser = Parser(prog="python -m vislam.study", description=__doc__)
    add_override_options(parser)
    add = parser.add_argument
    add("--out", type=Path, default=Path("studies"), help="folder of the studies (default: studies)")
    where = parser.add_mutually_exclusive_group()
    where.add_argument("--workers", type=int, help="number of processes (default: one for each CPU)")
    where.add_argument("--scheduler", metavar="ADDRESS", help="a Dask scheduler that runs, tls://host:port")
    where.add_argument("--scheduler-file", type=Path, metavar="FILE", help="the file that names it")
    for name, what in (
        ("ca", "certificate of who signed the scheduler's"),
        ("cert", "own certificate"),
        ("key", "its key"),
    ):
        add(f"--tls-{name}", type=Path, metavar="PEM", help=f"{what}, for a scheduler at tls://")
    add(
        "--wait-for-workers",
        type=float,
        default=60.0,
        metavar="SECONDS",
        help="how long to wait for a worker of the scheduler, at first and once all are gone (default: 60)",
    )
    return parser


def _refuse_bad(options: argparse.Namespace) -> None:
    """Raise ConfigError for options that no cluster could take."""
    if options.workers is not None and options.workers < 1:
        raise ConfigError(f"--workers must be at least 1, got {options.workers}")
    if not 0.0 < options.wait_for_workers < float("inf"):
        raise ConfigError(f"--wait-for-workers must be > 0 and finite [s], got {options.wait_for_workers}")
    tls = [options.tls_ca, options.tls_cert, options.tls_key]
    if any(tls) and not all(tls):
        raise ConfigError("--tls-ca, --tls-cert and --tls-key go together: give all three")
    if any(tls) and options.scheduler is None and options.scheduler_file is None:
        raise ConfigError(
            "--tls-ca is for --scheduler; workers of this machine have credentials of their own"
        )


def _study(options: argparse.Namespace) -> int:
    _refuse_bad(options)
    begin(f"study {options.config}")
    config = load_config(options)
    # Heavy imports follow the parsing, so that --help and a mistyped key answer at once.
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.study.cluster import Cluster  # noqa: PLC0415
    from vislam.study.conduct import conduct  # noqa: PLC0415
    from vislam.study.connection import Tls  # noqa: PLC0415

    tls = None if options.tls_ca is None else Tls(options.tls_ca, options.tls_cert, options.tls_key)
    cluster = Cluster(
        options.scheduler,
        options.scheduler_file,
        options.workers,
        tls=tls,
        patience=options.wait_for_workers,
    )
    return conduct(config, out=options.out, cluster=cluster, progress=Terminal())


if __name__ == "__main__":
    sys.exit(main())
