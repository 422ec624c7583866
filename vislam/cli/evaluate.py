"""``python -m vislam.evaluate results/<id>``: score saved runs again, beside trajectories from elsewhere.

Exit codes: 0 all checks hold, 1 an estimator had failed, 2 bad results or trajectory, 3 a check does not.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from vislam.cli.command import Parser, add_check_options, answer, refuse_bad_check_options


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _evaluate(options), verbose=options.verbose)


def _parser() -> Parser:
    parser = Parser(prog="python -m vislam.evaluate", description=__doc__)
    add = parser.add_argument
    add("results", type=Path, help="results folder of a comparison")
    add(
        "--trajectory",
        action="append",
        default=[],
        metavar="NAME=FILE[,format=tum][,pose_of=imu][,up=z]",
        help="a trajectory from elsewhere as one more column: format tum, euroc, kitti or kitti360; pose_of "
        "imu or left_camera; up z or -y (a world with a camera's axes)",
    )
    add_check_options(parser)
    add("--out", type=Path, help="folder for metrics, figures and report (default: the results folder)")
    add("--verbose", action="store_true", help="log what is read and dropped")
    return parser


def _evaluate(options: argparse.Namespace) -> int:
    # Heavy imports follow the parsing, so that --help answers at once.
    import numpy as np  # noqa: PLC0415

    from vislam.base.files import check_writable  # noqa: PLC0415
    from vislam.checks.judge import read_checklist  # noqa: PLC0415
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.comparison.imported import with_trajectories  # noqa: PLC0415
    from vislam.comparison.results import PLACES, SCHEMA_VERSION, Results, announce, conclude, publish  # noqa: PLC0415

    refuse_bad_check_options(options)
    results = Results.load(options.results)
    results = with_trajectories(results, options.trajectory)
    checklist = read_checklist(
        results.config, against=options.against, tolerance=options.tolerance, schema_version=SCHEMA_VERSION
    )
    checklist.refuse_other(digest=results.record.digest, reference=results.record.reference)
    folder = options.out or options.results
    for file in PLACES:
        check_writable(folder / file)
    # Saved numbers may be such that a metric of them overflows, or is none: it is then left out.
    with np.errstate(all="ignore"):
        published = publish(results, folder, checklist, report=not options.no_report)
    announce(results, published, Terminal())
    return conclude(results, published, junit=options.junit, rerun=options.rerun)


if __name__ == "__main__":
    sys.exit(main())
