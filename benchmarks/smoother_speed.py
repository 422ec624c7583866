"""``python -m benchmarks.smoother_speed``: how fast iSAM2 is, in ratios. It measures and never asserts.

Parts: ``recording`` (the smoothers over the main recording, with all tracks), ``settings`` (what
relinearisation and the other thresholds cost, and how far from the converged estimate they end),
``growth`` (long simulated drives). Times are those of the one thread that works.
Exit codes: 0 done, 2 bad arguments or data.
"""

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path

from benchmarks import smoother_growth, smoother_recording, smoother_settings
from benchmarks.telling import tell
from benchmarks.timing import Drive, Part
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
    main : Path or Config
        Config of the recording.
    data_dir : Path or None
        First folder to look for data.
    drives : tuple of int
        Frames of the simulated drives.
    window, warm : int
        Frames at the start and at the end of these that are compared, and frames before the first window.
    figure : Path or None
        File for the figure of the settings.
    """

    main: Path | Config = _CONFIGS / "ds3.yaml"
    data_dir: Path | None = None
    drives: tuple[int, ...] = smoother_growth.FRAMES
    window: int = 500
    warm: int = 200
    figure: Path | None = None

    @cached_property
    def drive(self) -> Drive:
        """The recording."""
        return Drive.open(self.main, data_dir=self.data_dir)

    def recording(self) -> Part:
        """The smoothers over the recording."""
        return smoother_recording.measure(self.drive)

    def settings(self) -> Part:
        """What the settings cost, and where they end."""
        return smoother_settings.measure(self.drive, figure=self.figure)

    def growth(self) -> Part:
        """Long simulated drives."""
        return smoother_growth.measure(frames=self.drives, window=self.window, warm=self.warm)


PARTS: Mapping[str, Callable[[Bench], Part]] = {
    "recording": Bench.recording,
    "settings": Bench.settings,
    "growth": Bench.growth,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _measure(options), verbose=False)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.smoother_speed", description=__doc__)
    add = parser.add_argument
    add("--data", type=Path, metavar="FOLDER", help="first folder to look for data")
    add(
        "--part", nargs="+", default=list(PARTS), metavar="NAME", help=f"of {', '.join(PARTS)} (default: all)"
    )
    add("--out", "--json", type=Path, metavar="FILE.json", help="file to write all numbers to")
    add("--figure", type=Path, metavar="FILE.png", help="file for the figure of the settings")
    return parser


def _measure(options: argparse.Namespace) -> int:
    for name in options.part:
        if name not in PARTS:
            raise ConfigError(f"--part {name}: no such part; known are {', '.join(PARTS)}")
    if options.data is not None and not options.data.is_dir():
        raise DataError(f"{options.data}: no such folder")
    for file in (options.out, options.figure):
        if file is not None:
            check_writable(file)
    bench = Bench(data_dir=options.data, figure=options.figure)
    run(bench, [name for name in PARTS if name in options.part], out=options.out)
    return 0


def run(bench: Bench, parts: Sequence[str], *, out: Path | None) -> None:
    """Measure the parts one after the other, print each, and write them all to ``out``."""
    tell({name: partial(PARTS[name], bench) for name in parts}, out=out)


if __name__ == "__main__":
    sys.exit(main())
