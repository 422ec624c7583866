"""Whether the steps of a long simulated drive stay as quick, and the memory as small, as in the beginning.

``python -m experiments.long_sequence`` runs an estimator over a drive without loop and prints the CPU time
of its steps and the resident memory, part of the drive by part, while it runs. The drive itself is in memory
from the start and counts for nothing; what an estimator keeps for its final estimate does.

CPU time depends on what else the machine does. So a few times in each part another estimator, a new one,
runs over the beginning of the drive: its steps are the same work each time, and the others are compared with
them.
"""

import argparse
import logging
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from experiments.growth import drive_config, give_back
from experiments.timing import Drive
from vislam.comparison.config import with_estimators
from vislam.comparison.members import Unbuilt, members
from vislam.core.estimator import Estimator
from vislam.core.frame import Frame

HEADER = "| frames | step, mean [ms] | median [ms] | slowest [ms] | a new one, median [ms] | memory [MB] |"
_NEW, _SKIPPED = 150, 50
"""Frames that a new estimator runs over, and how many of these are not timed, as a lag is not full before."""
_OFTEN = 10
"""New estimators a part."""
_STATUS = Path("/proc/self/status")


@dataclass(frozen=True)
class Part:
    """A part of a drive.

    Attributes
    ----------
    last : int
        Frames until its end.
    mean_s, median_s, slowest_s : float
        CPU time of its steps [s].
    new_s : float
        Median of that of the steps of new estimators at the same time [s].
    memory : int
        Resident memory at its end, beyond that before the first frame [bytes].
    """

    last: int
    mean_s: float
    median_s: float
    slowest_s: float
    new_s: float
    memory: int

    @property
    def row(self) -> str:
        """Row of the table."""
        seconds = (self.mean_s, self.median_s, self.slowest_s, self.new_s)
        times = " | ".join(f"{1e3 * value:.2f}" for value in seconds)
        return f"| {self.last} | {times} | {self.memory / 1e6:.0f} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run an estimator over a drive and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--estimator", default="fixed_lag", help="(default: %(default)s)")
    parser.add_argument("--frames", type=int, default=100_000, help="(default: %(default)s)")
    parser.add_argument("--tracks", type=float, default=15.0, help="in view (default: %(default)s)")
    parser.add_argument("--every", type=int, default=10_000, help="frames of a row (default: %(default)s)")
    options = parser.parse_args(arguments)
    logging.disable(logging.WARNING)
    config = with_estimators(drive_config(options.frames, options.tracks), {options.estimator: {}})
    drive = Drive.open(config)
    member = members(config)[options.estimator]

    def build() -> Estimator:
        found = member.build(drive.problem)
        assert not isinstance(found, Unbuilt)
        return found

    estimator = build()
    print(f"{HEADER}\n|{'---:|' * HEADER.count(' | ')}---:|")
    for part in parts(estimator, drive, build=build, every=options.every):
        print(part.row, flush=True)
    before = time.thread_time()
    final = estimator.finalize()
    print(f"\nend: {time.thread_time() - before:.1f} s; {resident() / 1e6:.0f} MB with drive and libraries")
    for name, count in final.counts.items():
        if count:
            print(f"{name}: {count}")
    return 0


def parts(
    estimator: Estimator, drive: Drive, *, build: Callable[[], Estimator], every: int
) -> Iterator[Part]:
    """Run an estimator over a drive, and give each part of it when it is over; ``build`` makes a new one."""
    times: list[float] = []
    beside: list[float] = []
    with threadpool_limits(1):
        near = drive.first(min(_NEW, len(drive.sequence)))
        beginning = list(near.sequence.frames(near.sigma))
        _again(build(), beginning)
        # With the first frame come the arrays of all: by now there is what does not grow.
        frames = drive.sequence.frames(drive.sigma)
        first = next(frames)
        start = _settled()
        for frame in chain([first], frames):
            times.append(_step(estimator, frame))
            done = frame.k + 1
            if done % max(every // _OFTEN, 1) == 0:
                beside += _again(build(), beginning)
            if done % every == 0 or done == len(drive.sequence):
                spent = np.array(times)
                yield Part(
                    done,
                    float(spent.mean()),
                    float(np.median(spent)),
                    float(spent.max()),
                    float(np.median(beside)),
                    _settled() - start,
                )
                times.clear()
                beside.clear()


def _again(estimator: Estimator, frames: Sequence[Frame]) -> list[float]:
    """Times of an estimator's steps over some frames, but for the first of these [s]."""
    times = [_step(estimator, frame) for frame in frames]
    return times[min(_SKIPPED, len(times) // 2) :]


def _step(estimator: Estimator, frame: Frame) -> float:
    before = time.thread_time()
    estimator.process(frame)
    return time.thread_time() - before


def resident() -> int:
    """Resident memory of this process [bytes]; Linux only."""
    (line,) = (one for one in _STATUS.read_text(encoding="ascii").splitlines() if one.startswith("VmRSS:"))
    return int(line.split()[1]) * 1024


def _settled() -> int:
    """Resident memory without what is garbage or was given back [bytes]."""
    give_back()
    return resident()


if __name__ == "__main__":
    sys.exit(main())
