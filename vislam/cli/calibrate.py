"""``python -m vislam.calibrate``: noise, biases and clock from the data alone; writes a config.

The reference of a recording is never looked at. The best config so far is written after each round and says
that it is unfinished. Exit codes: 0 done, 1 the filter did not finish or workers were lost, 2 bad config or
data, 130 interrupted.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from vislam.base.errors import ConfigError
from vislam.cli.command import Parser, add_config_options, answer, load_config

_BIAS_NAMES = ("gyro x", "gyro y", "gyro z", "velocity x", "velocity y", "velocity z")


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
    add("--inertial", action="store_true", help="estimate the noise of gyro and forward velocity too")
    add("--disparity-offset", action="store_true", help="estimate a constant error of the disparities too")
    add("--keep-bias-prior", action="store_true", help="leave the prior of the bias as it is in the config")
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
    from vislam.calibration.likelihood import first_frames  # noqa: PLC0415
    from vislam.calibration.output import Output  # noqa: PLC0415
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.comparison.open import open_dataset  # noqa: PLC0415

    terminal, out = Terminal(), Output(options.out)
    dataset = open_dataset(
        config.data,
        seed=config.seed,
        data_dir=options.data_dir,
        config_dir=options.config.parent,
        allow_substitute=not options.no_substitute,
        held_out=config.held_out,
    )
    if dataset.sequence.synthetic:
        terminal.note(dataset.notes[0])
    if options.frames is not None:
        dataset = replace(dataset, sequence=first_frames(dataset.sequence, options.frames))
    try:
        result = calibrate(
            config,
            replace(dataset, reference=None),
            parameters(config, inertial=options.inertial, disparity_offset=options.disparity_offset),
            processes=options.processes,
            say=terminal.note,
            keep=out.keep,
        )
    except BaseException:
        if out.kept:
            terminal.note(f"best config so far ({out.kept}): {out.path}")
        raise
    terminal.rows(
        ["parameter", "before", "calibrated", "95 % interval", "unit"],
        [
            [
                item.parameter.name,
                f"{item.before:.4g}",
                f"{item.value:.4g}" if item.needed else f"below {item.value:.2g}",
                f"{item.low:.4g} to {item.high:.4g}" if item.needed else "not needed by the data",
                item.parameter.unit,
            ]
            for item in result.parameters
        ]
        + [
            [
                f"bias, {name}",
                f"{old:.4g}",
                f"{new:.4g}",
                f"{new - 1.96 * sigma:.4g} to {new + 1.96 * sigma:.4g}",
                unit,
            ]
            for name, old, new, sigma, unit in zip(
                _BIAS_NAMES,
                config.noise.bias_mean,
                result.bias,
                result.bias_sigma,
                ["rad/s"] * 3 + ["m/s"] * 3,
                strict=True,
            )
        ],
        title=f"vislam calibration: {dataset.sequence.name}",
    )
    before, after = result.before.nis_per_dof, result.after.nis_per_dof
    terminal.note(f"NIS per degree of freedom: {before:.3f} before, {after:.3f} calibrated")
    written = result.config
    if options.keep_bias_prior:
        prior = config.noise
        written = replace(
            written, noise=replace(written.noise, bias_mean=prior.bias_mean, bias_sigma=prior.bias_sigma)
        )
    out.finish(written)
    terminal.note(f"config: {options.out}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
