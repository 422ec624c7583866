"""``python -m experiments.study_scaling``: how much faster two workers of a study are than one.

The same trials run with each number of workers, and the start of these is told apart. Other work on the
machine spoils the ratio: how much of its time a worker had a CPU is told.
"""

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from distributed import Client

from experiments.timing import CONFIGS, Part, tell
from vislam.base.errors import ConfigError
from vislam.base.files import check_writable
from vislam.cli.command import answer
from vislam.comparison import config as configuration
from vislam.comparison.config import Config
from vislam.study.cluster import Cluster, run_trials
from vislam.study.plan import Plan

WORKERS = (1, 2)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m experiments.study_scaling", description=__doc__)
    parser.add_argument("--trials", type=int, default=24, help="number of trials (default: 24)")
    parser.add_argument("--frames", type=int, default=400, help="frames of a drive (default: 400)")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="file to write all numbers to")
    options = parser.parse_args(arguments)
    return answer(lambda: _measure(options), verbose=False)


def _measure(options: argparse.Namespace) -> int:
    if options.trials < 1:
        raise ConfigError(f"--trials must be at least 1, got {options.trials}")
    if options.out is not None:
        check_writable(options.out)
    overrides = {"data.simulation.frames": options.frames}
    config = configuration.load(CONFIGS / "monte_carlo.yaml", overrides=overrides)
    tell({"scaling": lambda: scaling(config, trials=options.trials)}, out=options.out)
    return 0


def scaling(config: Config, *, trials: int) -> Part:
    """Run the trials with each number of workers, one after the other; nothing is written."""
    plan = Plan.of(replace(config, study={"seeds": trials}))
    found = {workers: _timed(plan, workers) for workers in WORKERS}
    one, two = (found[workers]["trials_s"] for workers in WORKERS)
    return Part(
        title=f"scaling: {trials} trials of {config.name}",
        header=["workers", "start [s]", "trials [s]", "workers on a CPU"],
        rows=[
            [f"{count}", f"{each['start_s']:.1f}", f"{each['trials_s']:.1f}", f"{100 * each['busy']:.0f} %"]
            for count, each in found.items()
        ],
        notes=(f"two workers are {one / two:.2f} times as fast as one",),
        values={"trials": trials, "ratio": one / two, "workers": {str(key): found[key] for key in found}},
    )


def _timed(plan: Plan, workers: int) -> dict[str, float]:
    """Time to workers that have imported all they need, and from there to the last result [s]."""
    began = time.perf_counter()
    with Cluster(workers=workers).connect() as client:
        ready, cpu = time.perf_counter(), _cpu(client)
        for _ in run_trials(client, plan.trials()):
            pass
        taken, cpu = time.perf_counter() - ready, _cpu(client) - cpu
    return {"start_s": ready - began, "trials_s": taken, "busy": cpu / (workers * taken)}


def _cpu(client: Client) -> float:
    """CPU time that the workers have taken so far [s]."""
    return float(sum(client.run(time.process_time).values()))


if __name__ == "__main__":
    sys.exit(main())
