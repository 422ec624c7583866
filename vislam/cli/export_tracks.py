"""``vislam export-tracks``: write the tracks of any source in the open track format.

What is written is what the source has: nothing is repaired. Reference poses and landmarks go along where the
source has them. Exit codes: 0 written, 2 wrong input.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from vislam.cli.command import Parser, answer


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _export(options), verbose=options.verbose)


def _parser() -> Parser:
    parser = Parser(prog="vislam export-tracks", description=__doc__)
    add = parser.add_argument
    add("source", metavar="SOURCE", help="a recording, a config, or the name of a shipped one")
    add("-o", "--out", type=Path, required=True, metavar="FILE", help="the .npz file to write")
    add("--seed", type=int, default=None, help="seed of whatever is simulated (default: the config's)")
    add("--data-dir", type=Path, help="first folder to look for data, before $VISLAM_DATA and data/")
    add("--verbose", action="store_true", help="log what is read")
    return parser


def _export(options: argparse.Namespace) -> int:
    # Heavy imports follow the parsing, so that --help and a mistyped key answer at once.
    from vislam.base.errors import ConfigError  # noqa: PLC0415
    from vislam.base.files import check_writable  # noqa: PLC0415
    from vislam.base.shipped import find_config  # noqa: PLC0415
    from vislam.cli.console import Terminal  # noqa: PLC0415
    from vislam.comparison import config as configuration  # noqa: PLC0415
    from vislam.comparison.open import open_recording  # noqa: PLC0415
    from vislam.datasets.find import search_path  # noqa: PLC0415
    from vislam.datasets.recording import Opening  # noqa: PLC0415
    from vislam.datasets.tracks_npz import write_tracks_npz  # noqa: PLC0415

    if options.out.suffix != ".npz":
        raise ConfigError(f"--out must name a .npz file, got {options.out}")
    check_writable(options.out)
    path = find_config(options.source)
    if path is not None and path.suffix in (".yaml", ".yml"):
        config = configuration.load(path)
        data, seed, home = config.data, config.seed, path.parent
    else:
        data, seed, home = configuration.DataConfig(file=options.source), 0, None
    seed = seed if options.seed is None else options.seed
    folders = [Path(), *search_path(options.data_dir, config_dir=home)]
    recording = open_recording(data, Opening(folders, seed), allow_substitute=False)
    write_tracks_npz(options.out, recording)
    terminal, sequence = Terminal(), recording.sequence
    for note in recording.notes:
        terminal.note(note)
    terminal.note(
        f"{options.out}: {len(sequence)} frames, {len(set(sequence.track.tolist()))} tracks, "
        f"{sequence.observations} observations"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
