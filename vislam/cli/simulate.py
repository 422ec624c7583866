"""``python -m vislam.simulate``: the simulated sequence of a config as a course file, with its truth.

The sequence is that of ``data.simulation``, faults included; the truth is a TUM file next to it. Exit codes:
0 done, 2 bad config or recorded path, or a sequence that the format cannot hold.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from vislam.cli.command import Parser, add_override_options, answer, load_config


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _simulate(options), verbose=options.verbose)


def _parser() -> Parser:
    parser = Parser(prog="python -m vislam.simulate", description=__doc__)
    add_override_options(parser)
    add = parser.add_argument
    add("--out", type=Path, required=True, help="file to write, FILE.npz; the truth goes to FILE_truth.tum")
    add("--data-dir", type=Path, help="first folder to look for a recorded path")
    return parser


def _simulate(options: argparse.Namespace) -> int:
    # Heavy imports follow the parsing, so that --help and a mistyped key answer at once.
    config = load_config(options)
    from vislam.base.errors import ConfigError  # noqa: PLC0415
    from vislam.base.files import check_writable, replace_whole  # noqa: PLC0415
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.comparison.simulated import simulated_drive  # noqa: PLC0415
    from vislam.datasets.course_export import write_course_npz  # noqa: PLC0415
    from vislam.datasets.export import write_tum  # noqa: PLC0415
    from vislam.datasets.find import search_path  # noqa: PLC0415

    simulation = config.data.simulation
    if simulation is None:
        raise ConfigError(f"{options.config}: data.simulation is missing; it states what to simulate")
    if simulation.inertial_noise == "step":
        raise ConfigError(
            "data.simulation.inertial_noise: must be sample; a course file has one sample a frame, got 'step'"
        )
    truth_path = options.out.with_name(f"{options.out.stem}_truth.tum")
    for path in (options.out, truth_path):
        check_writable(path)
    folders = search_path(options.data_dir, config_dir=options.config.parent)
    sequence, truth = simulated_drive(simulation, seed=config.seed, name=options.out.stem, folders=folders)
    # The truth comes into being inside, so that neither file is there without the other.
    with replace_whole(options.out) as temporary:
        write_course_npz(temporary, sequence)
        write_tum(truth_path, sequence.stamp, truth.world_T_imu)
    Terminal().note(
        f"{options.out}: {len(sequence)} frames, {len(set(sequence.track.tolist()))} tracks, "
        f"{len(sequence.track)} observations; truth: {truth_path}"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
