"""``python -m benchmarks.filter_speed``: how fast the filter is, in ratios. It measures and never asserts.

Parts: ``recording`` (both passes over the main recording), ``floor`` (the same against the filter's own
linear algebra), ``dense`` (the textbook filter beside it), ``growth`` (long simulated drives), ``tracks``
(cost of a track). Times are those of the one thread that works, unless it says otherwise.
Exit codes: 0 done, 2 bad arguments or data.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

from benchmarks import dense, floor, growth, recording, tracks
from benchmarks.telling import tell
from benchmarks.timing import Drive, Part, Timed
from vislam.base.errors import ConfigError, DataError
from vislam.base.files import check_writable
from vislam.cli.command import answer
from vislam.comparison.config import Config

_CONFIGS = Path(__file__).parents[1] / "configs"


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
    few : int
        Frames that two threads are tried on.
    dense_seconds : float
        Time that the textbook filter is given [s].
    drives : tuple of int
        Frames of the simulated drives.
    window : int
        Frames at the start and at the end of these that are compared.
    thinned : int
        Frames on which tracks are thinned.
    """

    main: Path | Config = _CONFIGS / "ds3.yaml"
    many_tracks: Path | Config = _CONFIGS / "kitti00.yaml"
    data_dir: Path | None = None
    repeats: int = 2
    few: int = 20
    dense_seconds: float = 120.0
    drives: tuple[int, ...] = growth.FRAMES
    window: int = 1_000
    thinned: int = 40

    @cached_property
    def drive(self) -> Drive:
        """The recording."""
        return Drive.open(self.main, data_dir=self.data_dir)

    @cached_property
    def runs(self) -> dict[str, Timed]:
        """The members' runs over it."""
        return recording.members(self.drive, repeats=self.repeats)

    def recording(self) -> Part:
        """Both passes over the recording."""
        return recording.measure(self.drive, self.runs, few=self.few)

    def floor(self) -> Part:
        """The same against the filter's own linear algebra."""
        return floor.measure(self.drive.name, self.runs, repeats=self.repeats)

    def dense(self) -> Part:
        """The textbook filter beside it."""
        return dense.measure(self.drive, seconds=self.dense_seconds)

    def growth(self) -> Part:
        """Long simulated drives."""
        return growth.measure(frames=self.drives, window=self.window)

    def tracks(self) -> Part:
        """The cost of a track."""
        return tracks.measure(Drive.open(self.many_tracks, data_dir=self.data_dir), frames=self.thinned)


PARTS: Mapping[str, Callable[[Bench], Part]] = {
    "recording": Bench.recording,
    "floor": Bench.floor,
    "dense": Bench.dense,
    "growth": Bench.growth,
    "tracks": Bench.tracks,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _measure(options), verbose=False)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.filter_speed", description=__doc__)
    add = parser.add_argument
    add("--data", type=Path, metavar="FOLDER", help="first folder to look for data")
    add(
        "--part", nargs="+", default=list(PARTS), metavar="NAME", help=f"of {', '.join(PARTS)} (default: all)"
    )
    add("--out", type=Path, metavar="FILE.json", help="file to write all numbers to")
    add("--dense-seconds", type=float, default=120.0, help="time for the textbook filter (default: 120)")
    return parser


def _measure(options: argparse.Namespace) -> int:
    for name in options.part:
        if name not in PARTS:
            raise ConfigError(f"--part {name}: no such part; known are {', '.join(PARTS)}")
    if not 0.0 < options.dense_seconds < float("inf"):
        raise ConfigError(f"--dense-seconds {options.dense_seconds:g}: expected a positive time")
    if options.data is not None and not options.data.is_dir():
        raise DataError(f"{options.data}: no such folder")
    if options.out is not None:
        check_writable(options.out)
    bench = Bench(data_dir=options.data, dense_seconds=options.dense_seconds)
    run(bench, [name for name in PARTS if name in options.part], out=options.out)
    return 0


def run(bench: Bench, parts: Sequence[str], *, out: Path | None) -> None:
    """Measure the parts one after the other, print each, and write them all to ``out``."""
    tell({name: partial(PARTS[name], bench) for name in parts}, out=out)


if __name__ == "__main__":
    sys.exit(main())
