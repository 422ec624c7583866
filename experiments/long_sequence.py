"""Whether the steps of a long simulated drive stay as quick, and the memory as small, as in the beginning.

``python -m experiments.long_sequence`` runs an estimator over a drive without loop and prints the CPU time
of its steps and the resident memory, part of the drive by part, while it runs. The drive itself is in memory
from the start and counts for nothing; what an estimator keeps for its final estimate does.
"""

import argparse
import logging
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from experiments.growth import drive_config, give_back
from experiments.timing import Drive
from vislam.comparison.config import with_estimators
from vislam.comparison.members import Unbuilt, members
from vislam.core.estimator import Estimator

HEADER = "| frames | step, mean [ms] | step, median [ms] | slowest step [ms] | memory [MB] |"
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
    memory : int
        Resident memory at its end, beyond that before the first frame [bytes].
    """

    last: int
    mean_s: float
    median_s: float
    slowest_s: float
    memory: int

    @property
    def row(self) -> str:
        """Row of the table."""
        times = " | ".join(f"{1e3 * value:.2f}" for value in (self.mean_s, self.median_s, self.slowest_s))
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
    estimator = members(config)[options.estimator].build(drive.problem)
    assert not isinstance(estimator, Unbuilt)
    print(f"{HEADER}\n|---:|---:|---:|---:|---:|")
    for part in parts(estimator, drive, every=options.every):
        print(part.row, flush=True)
    before = time.thread_time()
    final = estimator.finalize()
    print(f"\nend: {time.thread_time() - before:.1f} s; {resident() / 1e6:.0f} MB with drive and libraries")
    for name, count in final.counts.items():
        if count:
            print(f"{name}: {count}")
    return 0


def parts(estimator: Estimator, drive: Drive, *, every: int) -> Iterator[Part]:
    """Run an estimator over a drive, and give each part of it when it is over."""
    times: list[float] = []
    start = _settled()
    with threadpool_limits(1):
        for frame in drive.sequence.frames(drive.sigma):
            before = time.thread_time()
            estimator.process(frame)
            times.append(time.thread_time() - before)
            if (frame.k + 1) % every == 0 or frame.k + 1 == len(drive.sequence):
                spent = np.array(times)
                yield Part(
                    frame.k + 1,
                    float(spent.mean()),
                    float(np.median(spent)),
                    float(spent.max()),
                    _settled() - start,
                )
                times.clear()


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
