"""``python -m experiments.speed``: what estimators cost, in ratios of one run. It measures, never asserts.

Parts: ``floor`` (the filter against its own linear algebra), ``textbook`` (the filter that keeps all
landmarks beside it), ``tracks`` (cost of a track), ``gtsam`` (the smoother against GTSAM's solver),
``growth`` (long simulated drives). Times are those of the one thread that works.
Exit codes: 0 done, 2 bad arguments or data.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

from experiments import floor, growth, inside_gtsam, textbook
from experiments.timing import CONFIGS, Drive, Part, tell
from vislam.base.errors import ConfigError, DataError
from vislam.base.files import check_writable
from vislam.cli.command import answer
from vislam.comparison.config import Config


@dataclass(frozen=True)
class Bench:
    """What is measured on, and for how long.

    Attributes
    ----------
    main, many_tracks : Path or Config
        Config of the recording, and of the drive with many tracks in view.
    data_dir : Path or None
        First folder to look for data.
    repeats : int
        Runs of which the least times count.
    seconds : float
        Time that the textbook filter is given [s].
    thinned : int
        Frames on which tracks are thinned.
    drives : mapping of str to sequence of int
        Frames of the simulated drives of each estimator.
    window, warm : int
        Frames at the start and at the end of these that are compared, and those before the first window.
    in_view : float
        Tracks in view of these.
    """

    main: Path | Config = CONFIGS / "ds3.yaml"
    many_tracks: Path | Config = CONFIGS / "kitti00.yaml"
    data_dir: Path | None = None
    repeats: int = 2
    seconds: float = 120.0
    thinned: int = 40
    drives: Mapping[str, Sequence[int]] = field(default_factory=lambda: growth.DRIVES)
    window: int = 500
    warm: int = 200
    in_view: float = growth.TRACKS

    @cached_property
    def drive(self) -> Drive:
        """The recording."""
        return Drive.open(self.main, data_dir=self.data_dir)

    def tracks(self) -> Part:
        """The cost of a track."""
        return textbook.tracks(Drive.open(self.many_tracks, data_dir=self.data_dir), frames=self.thinned)


PARTS: Mapping[str, Callable[[Bench], Part]] = {
    "floor": lambda bench: floor.measure(bench.drive, repeats=bench.repeats),
    "textbook": lambda bench: textbook.textbook(bench.drive, seconds=bench.seconds),
    "tracks": Bench.tracks,
    "gtsam": lambda bench: inside_gtsam.inside_gtsam(bench.drive),
    "growth": lambda bench: growth.growth(
        bench.drives, window=bench.window, warm=bench.warm, tracks=bench.in_view
    ),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m experiments.speed", description=__doc__)
    add = parser.add_argument
    add("--data", type=Path, metavar="FOLDER", help="first folder to look for data")
    add(
        "--part", nargs="+", default=list(PARTS), metavar="NAME", help=f"of {', '.join(PARTS)} (default: all)"
    )
    add("--seconds", type=float, default=120.0, help="time for the textbook filter (default: 120)")
    add("--out", type=Path, metavar="FILE.json", help="file to write all numbers to")
    add("--in-view", type=float, default=growth.TRACKS, help="tracks in view of the drives of growth")
    add(
        "--drive",
        action="append",
        default=[],
        metavar="NAME=FRAMES",
        help="a drive of growth, in place of its own: ekf or a variant of the smoother, and its length",
    )
    options = parser.parse_args(arguments)
    return answer(lambda: _measure(options), verbose=False)


def _measure(options: argparse.Namespace) -> int:
    for name in options.part:
        if name not in PARTS:
            raise ConfigError(f"--part {name}: no such part; known are {', '.join(PARTS)}")
    if not 0.0 < options.seconds < float("inf"):
        raise ConfigError(f"--seconds {options.seconds:g}: expected a positive time")
    if options.data is not None and not options.data.is_dir():
        raise DataError(f"{options.data}: no such folder")
    if options.out is not None:
        check_writable(options.out)
    if not 1.0 <= options.in_view < float("inf"):
        raise ConfigError(f"--in-view {options.in_view:g}: expected a number of tracks, 1 or more")
    bench = Bench(data_dir=options.data, seconds=options.seconds, in_view=options.in_view)
    if options.drive:
        bench = replace(bench, drives=drives_of(options.drive, least=bench.warm + bench.window))
    run(bench, options.part, out=options.out)
    return 0


def drives_of(given: Sequence[str], *, least: int) -> dict[str, list[int]]:
    """Frames by estimator of options ``NAME=FRAMES``; ConfigError if one is not such, or below ``least``."""
    drives: dict[str, list[int]] = {}
    for one in given:
        name, _, frames = one.partition("=")
        if name not in growth.NAMES or not frames.isdecimal() or int(frames) < least:
            known = ", ".join(growth.NAMES)
            raise ConfigError(f"--drive {one}: expected NAME=FRAMES, NAME of {known}, {least} frames or more")
        drives.setdefault(name, []).append(int(frames))
    return drives


def run(bench: Bench, parts: Sequence[str], *, out: Path | None) -> None:
    """Measure the parts one after the other, print each, and write them all to ``out``."""
    tell({name: partial(PARTS[name], bench) for name in parts}, out=out)


if __name__ == "__main__":
    sys.exit(main())
