"""``python -m benchmarks.study_scaling``: how much faster two workers are than one; it never asserts.

The same trials run with each number of workers, and the start of these is told apart. Other work on the
machine spoils the ratio: the load before each run is told, and how much of its time a worker had a CPU.
Exit codes: 0 done, 2 bad arguments.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from distributed import Client

from benchmarks.telling import tell
from benchmarks.timing import Part
from vislam.base.errors import ConfigError
from vislam.base.files import check_writable
from vislam.base.progress import Silent
from vislam.cli.command import answer
from vislam.comparison import config as configuration
from vislam.comparison.config import Config
from vislam.study.cluster import Cluster, run_trials
from vislam.study.conduct import conclude
from vislam.study.folder import StudyFolder
from vislam.study.plan import Plan

WORKERS = (1, 2)
TARGET = 1.8
"""By what factor two workers should be faster than one."""
_CONFIG = Path(__file__).parents[1] / "configs" / "monte_carlo.yaml"


@dataclass(frozen=True)
class Timed:
    """A study with a number of workers.

    Attributes
    ----------
    workers : int
    load : float
        Processes that wanted a CPU in the minute before.
    start_s : float
        From nothing to workers that have imported all they need [s].
    trials_s : float
        From there to the last trial's file [s].
    conclude_s : float
        Tables and page [s].
    worker_cpu_s, driver_cpu_s : float
        CPU time of all workers and of this process, scheduler included, during the trials [s].
    """

    workers: int
    load: float
    start_s: float
    trials_s: float
    conclude_s: float
    worker_cpu_s: float
    driver_cpu_s: float

    @property
    def busy(self) -> float:
        """Share of the trials' time in which a worker had a CPU."""
        return self.worker_cpu_s / (self.workers * self.trials_s)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    options = _parser().parse_args(arguments)
    return answer(lambda: _measure(options), verbose=False)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.study_scaling", description=__doc__)
    add = parser.add_argument
    add("--trials", type=int, default=24, help="number of trials (default: 24)")
    add("--frames", type=int, default=400, help="frames of a drive (default: 400)")
    add("--repeats", type=int, default=1, help="runs with each number of workers (default: 1)")
    add("--out", type=Path, metavar="FILE.json", help="file to write all numbers to")
    return parser


def _measure(options: argparse.Namespace) -> int:
    for name in ("trials", "frames", "repeats"):
        if getattr(options, name) < 1:
            raise ConfigError(f"--{name} must be at least 1, got {getattr(options, name)}")
    if options.out is not None:
        check_writable(options.out)
    config = configuration.load(_CONFIG, overrides={"data.simulation.frames": options.frames})
    run(config, trials=options.trials, repeats=options.repeats, out=options.out)
    return 0


def run(config: Config, *, trials: int, repeats: int, out: Path | None) -> None:
    """Measure, print, and write the numbers to ``out``."""
    plan = Plan.of(replace(config, study={"seeds": trials}))
    tell({"scaling": lambda: measure(plan, repeats=repeats)}, out=out)


def measure(plan: Plan, *, repeats: int) -> Part:
    """Run the study with each number of workers, in turns, so that what changes meanwhile meets all."""
    found = [timed(plan, workers) for _ in range(repeats) for workers in WORKERS]
    quickest = {
        workers: min((each for each in found if each.workers == workers), key=lambda each: each.trials_s)
        for workers in WORKERS
    }
    one = quickest[1]
    ratios = {workers: one.trials_s / each.trials_s for workers, each in quickest.items()}
    rows = [
        [
            f"{each.workers}",
            f"{each.load:.2f}",
            *(f"{seconds:.1f}" for seconds in (each.start_s, each.trials_s, each.conclude_s)),
            f"{one.trials_s / each.trials_s:.2f}",
            f"{each.worker_cpu_s / plan.study.seeds:.2f}",
            f"{100.0 * each.busy:.0f} %",
            f"{1e3 * each.driver_cpu_s / plan.study.seeds:.0f}",
        ]
        for each in found
    ]
    return Part(
        title=f"scaling: {plan.study.seeds} trials of {plan.config.name}",
        header=[
            "workers",
            "load before",
            "start [s]",
            "trials [s]",
            "conclusion [s]",
            "times as fast",
            "CPU of a trial [s]",
            "workers on a CPU",
            "driver's CPU per trial [ms]",
        ],
        rows=rows,
        notes=(
            f"two workers are {ratios[2]:.2f} times as fast as one, the quickest of {repeats} each; "
            f"target: {TARGET}",
        ),
        values={"trials": plan.study.seeds, "ratio": ratios[2], "runs": [asdict(each) for each in found]},
    )


def timed(plan: Plan, workers: int) -> Timed:
    """Run the study from nothing to its page, in a folder that is removed again."""
    load = os.getloadavg()[0]
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as place:
        folder = StudyFolder(Path(place) / "study")
        with Cluster(workers=workers).connect() as client:
            ready, cpu = time.perf_counter(), _cpu(client)
            own = time.process_time()
            for trial, result in run_trials(client, plan.trials()):
                folder.save(trial, result)
            done, own, cpu = time.perf_counter(), time.process_time() - own, _cpu(client) - cpu
        closed = time.perf_counter()
        conclude(plan, folder, Silent())
        end = time.perf_counter()
    return Timed(
        workers=workers,
        load=load,
        start_s=ready - began,
        trials_s=done - ready,
        conclude_s=end - closed,
        worker_cpu_s=cpu,
        driver_cpu_s=own,
    )


def _cpu(client: Client) -> float:
    """CPU time that the workers have taken so far [s]."""
    return float(sum(client.run(time.process_time).values()))


if __name__ == "__main__":
    sys.exit(main())
