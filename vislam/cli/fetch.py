"""``python -m vislam.fetch``: download recordings into the user cache, where ``vislam.compare`` finds them.

Exit codes: 0 done, 2 could not fetch, 130 interrupted (nothing incomplete is kept).
"""

import argparse
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from vislam.base.errors import DataError
from vislam.cli.command import Parser, answer
from vislam.cli.console import Terminal
from vislam.datasets import archives, download

_DAY = 86400.0
_TOLD = 100_000_000
"""Bytes after which a line says how many have come."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _list(options) if options.list else _fetch(options), verbose=False)


def _parser() -> Parser:
    parser = Parser(prog="python -m vislam.fetch", description=__doc__)
    add = parser.add_argument
    add("names", nargs="*", metavar="NAME", help="recordings to fetch")
    add("--list", action="store_true", help="list what can be fetched and stop")
    add("--folder", type=Path, help="where files go, in place of $VISLAM_CACHE or the user cache")
    add("--base-url", metavar="URL", help="server in place of the mirrors; files are at URL/<file name>")
    add(
        "--timeout",
        type=_seconds,
        default=download.TIMEOUT,
        metavar="SECONDS",
        help=f"give a server up after so long without a byte (default: {download.TIMEOUT:g})",
    )
    add(
        "--deadline",
        type=_seconds,
        metavar="SECONDS",
        help="give a server up that has not given a whole file after so long (default: two timeouts and what "
        f"the file takes at {download.SLOWEST / 1000.0:g} kB/s)",
    )
    return parser


def _seconds(text: str) -> float:
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0.0 < seconds <= _DAY:
        raise argparse.ArgumentTypeError(f"expected a number of seconds > 0, at most a day, got {text}")
    return seconds


def _list(options: argparse.Namespace) -> int:
    terminal = Terminal()
    for name, known in download.RECORDINGS.items():
        files = ", ".join(f"{file.name} ({file.size} bytes)" for file in known.files)
        terminal.note(f"{name}: {known.title}; {files}")
    terminal.note(
        f"EuRoC, stereo images and inertial samples, a gigabyte or two each: {', '.join(archives.EUROC)}"
    )
    terminal.note(f"KITTI raw, stereo images with OXTS, by the name of a drive: {archives.KITTI_RAW}")
    terminal.note(f"into {options.folder or download.cache_folder()}")
    return 0


def _fetch(options: argparse.Namespace) -> int:
    if not options.names:
        raise DataError(
            f"name what to fetch: {', '.join(download.RECORDINGS)}, or a recording of EuRoC or KITTI raw"
        )
    # A mistyped name is said before anything is downloaded.
    wanted = {name: archives.image_set(name) or _recording(name) for name in options.names}
    terminal = Terminal()
    for name, recording in wanted.items():
        if isinstance(recording, archives.ImageSet):
            _fetch_images(recording, options, terminal)
        else:
            _fetch_one(name, recording, options, terminal)
    euroc = [name in archives.EUROC for name in wanted]
    if not all(euroc):
        terminal.note(download.LICENCE)
    if any(euroc):
        terminal.note(download.EUROC_LICENCE)
    return 0


def _recording(name: str) -> download.Recording:
    if name in download.RECORDINGS:
        return download.recording(name)
    raise DataError(
        f"{name}: no such recording; known are {', '.join(sorted(download.RECORDINGS))}, those of EuRoC "
        f"({archives.EUROC[0]} ...) and of KITTI raw ({archives.KITTI_RAW}); --list lists them"
    )


def _fetch_images(wanted: archives.ImageSet, options: argparse.Namespace, terminal: Terminal) -> None:
    told = 0

    def watch(received: int) -> None:
        """Report now and then: how much there is to come is not known."""
        nonlocal told
        if received < told:
            told = 0
        if received - told >= _TOLD:
            told = received
            terminal.note(f"{wanted.name}: {received / 1e6:.0f} MB")

    folder = archives.fetch_images(
        wanted,
        folder=Path(os.path.expanduser(options.folder)) if options.folder else download.cache_folder(),
        base_url=options.base_url,
        timeout=options.timeout,
        deadline=options.deadline,
        say=terminal.note,
        watch=watch,
    )
    terminal.note(f"{wanted.name}: vislam compare --data {folder}")


def _fetch_one(
    name: str, recording: download.Recording, options: argparse.Namespace, terminal: Terminal
) -> None:
    with terminal.bar(name, recording.size) as bar:
        download.fetch(
            name,
            base_url=options.base_url,
            folder=options.folder,
            timeout=options.timeout,
            deadline=options.deadline,
            say=terminal.note,
            watch=bar.done,
        )
    if recording.missing is not None:
        terminal.note(f"{name}: {recording.missing}")


if __name__ == "__main__":
    sys.exit(main())
