"""``python -m vislam.calibrate``: noise, biases and clock from the data alone; writes a config.

The reference of a recording is never looked at. The best config so far is written after each round and says
that it is unfinished. In the end, what was found is scored on parts of the recording that it was not fitted
to; where it predicts worse there, the config from before is written, with a line that says so.

Exit codes: 0 done, 1 the filter did not finish or workers were lost, 2 bad config or data, 3 the config from
before was written, 130 interrupted.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from vislam.base.errors import ConfigError
from vislam.cli.command import Parser, add_config_options, answer, load_config


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _calibrate(options), verbose=options.verbose)


def _parser() -> Parser:
    parser = Parser(prog="python -m vislam.calibrate", description=__doc__)
    add_config_options(parser)
    add = parser.add_argument
    add(
        "--out", type=Path, default=Path("calibrated.yaml"), help="config to write (default: calibrated.yaml)"
    )
    add(
        "--inertial",
        action="store_true",
        help="estimate the noise of gyro and forward velocity too; with motion: imu the walks",
    )
    add("--disparity-offset", action="store_true", help="estimate a constant error of the disparities too")
    add(
        "--keep-bias-prior",
        action="store_true",
        help="leave the prior of the bias as it is, whatever stops tell",
    )
    add(
        "--also",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="score what is found on another recording, too, of the same rig and repairs; can be repeated",
    )
    add("--frames", type=int, help="use the first so many frames only")
    add("--processes", type=int, default=2, help="filters run side by side (default: 2)")
    return parser


def _calibrate(options: argparse.Namespace) -> int:
    # Heavy imports follow the parsing, so that --help and a mistyped key answer at once.
    for name, least in (("processes", 1), ("frames", 2)):
        if (got := getattr(options, name)) is not None and got < least:
            raise ConfigError(f"--{name} must be at least {least}, got {got}")
    config = load_config(options)
    from dataclasses import replace  # noqa: PLC0415

    from vislam.calibration import calibrate, parameters  # noqa: PLC0415
    from vislam.calibration.output import Output  # noqa: PLC0415
    from vislam.calibration.recordings import first_frames_of, other_recording  # noqa: PLC0415
    from vislam.calibration.tables import tables  # noqa: PLC0415
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.comparison.open import open_dataset  # noqa: PLC0415

    terminal, out = Terminal(), Output(options.out)
    datasets = [
        open_dataset(
            data,
            seed=config.seed,
            data_dir=options.data_dir,
            config_dir=options.config.parent,
            allow_substitute=not options.no_substitute,
            held_out=config.held_out,
        )
        for data in (config.data, *(other_recording(config.data, str(file)) for file in options.also))
    ]
    if datasets[0].sequence.synthetic:
        terminal.note(datasets[0].notes[0])
    datasets = [replace(first_frames_of(one, options.frames), reference=None) for one in datasets]
    try:
        result = calibrate(
            config,
            datasets[0],
            parameters(config, inertial=options.inertial, disparity_offset=options.disparity_offset),
            also=datasets[1:],
            keep_bias_prior=options.keep_bias_prior,
            processes=options.processes,
            say=terminal.note,
            keep=out.keep,
        )
    except BaseException:
        if out.kept:
            terminal.note(f"best config so far ({out.kept}): {out.path}")
        raise
    for table in tables(result, config, name=datasets[0].sequence.name):
        terminal.rows(table.header, table.rows, title=table.title)
    for one in result.candidates:
        for objection in one.objections:
            terminal.note(f"{one.name}: {objection}")
    out.finish(result.config, rejected=result.rejected)
    if result.rejected:
        terminal.note("what was found predicts worse than the config from before, which is written again")
    terminal.note(f"config: {options.out}")
    return 3 if result.rejected else 0


if __name__ == "__main__":
    sys.exit(main())
