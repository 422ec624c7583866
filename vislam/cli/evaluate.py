"""``vislam evaluate``: score trajectory files against a reference, or saved runs of a comparison again.

``vislam evaluate --reference gt.csv --trajectory orb=a.txt --trajectory vins=b.csv`` needs no run of ours;
``gt.csv`` as the first argument means the same. ``vislam evaluate results/<id>`` scores saved runs, beside
trajectories.
``vislam evaluate --suite suite.yaml`` scores many sequences. Formats are guessed from the content and said.
Exit codes: 0 all checks hold, 1 an estimator had failed, 2 bad results or trajectory, 3 a check does not.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from vislam.base.errors import ConfigError
from vislam.cli.command import Parser, add_check_options, answer, begin, refuse_bad_check_options

_ONE = "NAME=FILE[,key=value...]"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _evaluate(options), verbose=options.verbose)


def _parser() -> Parser:
    parser = Parser(prog="vislam evaluate", description=__doc__)
    add = parser.add_argument
    add("results", type=Path, nargs="?", help="results folder of a comparison, or a reference file")
    add("--reference", metavar="FILE[,key=value...]", help="what is scored against; or {YAML}")
    add(
        "--trajectory",
        action="append",
        default=[],
        metavar=_ONE,
        help="a trajectory file, with any of format=, unit=, quaternion=, conjugated=, inverted=, "
        "pose_of=, up=, clock_offset= (seconds, or estimate), alignment=sim3, times=, frames=, cov=, "
        "cov_order=, cov_frame=, map=, topic=, strict=; or {YAML}, for paths with commas",
    )
    add("--suite", type=Path, help="YAML of many sequences, each with a reference and trajectories")
    add(
        "--association",
        choices=("auto", "nearest", "interpolate"),
        default="auto",
        help="nearest stamps, or the denser side interpolated at the stamps of the sparser (default: auto, "
        "nearest unless that leaves out more than half)",
    )
    add(
        "--max-time-difference",
        type=float,
        default=0.01,
        metavar="S",
        help="farthest that two stamps may be apart (default: 0.01 s)",
    )
    add(
        "--start",
        type=float,
        default=0.0,
        metavar="S",
        help="leave out what is before, from the reference's start on",
    )
    add("--end", type=float, metavar="S", help="and up to here")
    add("--strict", action="store_true", help="refuse files that would have to be mended")
    add("--checks", type=Path, help="YAML with a list of checks, as a config has them")
    add_check_options(parser)
    add(
        "--export",
        type=Path,
        metavar="FOLDER",
        help="write all trajectories for evo, rpg, OpenVINS, smfeval, KITTI",
    )
    add("--out", type=Path, help="folder for metrics, figures and report (default: the results folder)")
    add("--verbose", action="store_true", help="log what is read and dropped")
    return parser


def _evaluate(options: argparse.Namespace) -> int:
    # Heavy imports follow the parsing, so that --help answers at once.
    refuse_bad_check_options(options)
    begin(f"evaluate {options.results}")
    if options.suite is not None:
        return _suite(options)
    if options.results is not None and options.results.is_file():
        if options.reference is not None:
            raise ConfigError("a reference is named twice, with --reference and without")
        options.reference, options.results = str(options.results), None
    if options.reference is not None:
        if options.results is not None:
            raise ConfigError("give a results folder, whose reference is used, or --reference, not both")
        return _files(options)
    if options.results is None:
        raise ConfigError("give a results folder, or --reference and --trajectory, or --suite")
    return _saved(options)


def _saved(options: argparse.Namespace) -> int:
    from vislam.checks.judge import read_checklist  # noqa: PLC0415
    from vislam.comparison.imported import with_trajectories  # noqa: PLC0415
    from vislam.comparison.results import SCHEMA_VERSION, Results  # noqa: PLC0415

    results = Results.load(options.results)
    results = with_trajectories(results, _trajectories(options), _matching(options)[1])
    checklist = read_checklist(
        results.config, against=options.against, tolerance=options.tolerance, schema_version=SCHEMA_VERSION
    )
    return _publish(options, results, checklist, options.out or options.results)


def _files(options: argparse.Namespace) -> int:
    from vislam.base.files import folder_name  # noqa: PLC0415
    from vislam.checks.judge import read_checklist  # noqa: PLC0415
    from vislam.comparison.imported import parse_trajectory  # noqa: PLC0415
    from vislam.comparison.results import SCHEMA_VERSION  # noqa: PLC0415
    from vislam.comparison.scoring import ScoringConfig, read_checks, score_files  # noqa: PLC0415

    reference = parse_trajectory(options.reference, option="--reference", name="reference")
    if not options.trajectory:
        raise ConfigError(f"--reference needs a --trajectory {_ONE} to score")
    config = ScoringConfig(
        name=reference.name,
        reference=_strict(options, reference),
        trajectories=tuple(_trajectories(options)),
        matching=_matching(options)[0],
        checks=() if options.checks is None else read_checks(options.checks),
    )
    results = score_files(config)
    checklist = read_checklist(
        config, against=options.against, tolerance=options.tolerance, schema_version=SCHEMA_VERSION
    )
    folder = options.out or Path("results") / folder_name(f"evaluate-{config.name}")
    return _publish(options, results, checklist, folder)


def _suite(options: argparse.Namespace) -> int:
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.comparison.suite import read_suite, run_suite  # noqa: PLC0415

    if options.trajectory or options.reference or options.results:
        raise ConfigError("--suite names all files itself: no reference, trajectory or results beside it")
    suite = read_suite(options.suite)
    return run_suite(
        suite, options.out or Path("results") / "suite", Terminal(), report=not options.no_report
    )


def _publish(options: argparse.Namespace, results: Any, checklist: Any, folder: Path) -> int:
    import numpy as np  # noqa: PLC0415

    from vislam.base.files import check_writable  # noqa: PLC0415
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.comparison.layouts import export_layouts  # noqa: PLC0415
    from vislam.comparison.results import PLACES, announce, conclude, publish  # noqa: PLC0415

    checklist.refuse_other(digest=results.record.digest, reference=results.record.reference)
    for file in PLACES:
        check_writable(folder / file)
    # Saved numbers may be such that a metric of them overflows, or is none: it is then left out.
    with np.errstate(all="ignore"):
        published = publish(results, folder, checklist, report=not options.no_report)
    announce(results, published, Terminal())
    if options.export is not None:
        export_layouts(results, options.export)
    return conclude(results, published, junit=options.junit, rerun=options.rerun, png=options.png)


def _trajectories(options: argparse.Namespace) -> list[Any]:
    from vislam.comparison.imported import parse_trajectory  # noqa: PLC0415

    return [_strict(options, parse_trajectory(text)) for text in options.trajectory]


def _strict(options: argparse.Namespace, config: Any) -> Any:
    from dataclasses import replace  # noqa: PLC0415

    return replace(config, strict=True) if options.strict else config


def _matching(options: argparse.Namespace) -> tuple[Any, Any]:
    from vislam.base.settings import parse  # noqa: PLC0415
    from vislam.comparison.scoring import matching_of  # noqa: PLC0415
    from vislam.datasets.settings import MatchingConfig  # noqa: PLC0415

    tree = {
        "association": options.association,
        "max_time_difference": options.max_time_difference,
        "start": options.start,
        "end": options.end,
    }
    config = parse(MatchingConfig, tree, at="matching")
    return config, matching_of(config)


if __name__ == "__main__":
    sys.exit(main())
