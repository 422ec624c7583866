"""Runs tiny trials with large results, and prints the driver's memory [MB] as their number grows.

First line: while they run, after 100 and after 1,000. Second line: most while 100 are concluded, then 1,000.
"""

import sys
import tracemalloc
from pathlib import Path

import psutil

from tests.study.synthetic import record
from vislam.base.progress import Silent
from vislam.comparison.config import Config, DataConfig
from vislam.comparison.identity import code_digest
from vislam.simulation import SimulationConfig
from vislam.study.cluster import Cluster, run_trials
from vislam.study.conduct import conclude
from vislam.study.folder import StudyFolder
from vislam.study.plan import Plan

NUMBERS = (100, 1000)
RUNS = ("dead_reckoning", "ekf", "eks", "isam2")


def large(tree, seed):
    """Result with as many numbers as four estimators leave."""
    values = {f"metric_{index}": seed + 0.1 * index for index in range(110)}
    values |= {"ate_rmse": 1.0 + 0.01 * seed, "nees_pose": 1.0}
    found = record(seed, {}, dict.fromkeys(RUNS, values))
    del found["point"]
    return {**found, "statistics": [], "seconds": 0.0, "code": code_digest(), "inputs": ""}


def planned(number):
    return Plan.of(
        Config(
            name="thousand",
            data=DataConfig(simulation=SimulationConfig()),
            estimators={name: {} for name in RUNS},
            study={"seeds": number},
        )
    )


def main(path):
    folder, ran, concluded = StudyFolder(path), [], []
    with Cluster(workers=1).connect() as client:
        for count, (trial, result) in enumerate(
            run_trials(client, planned(NUMBERS[-1]).trials(), work=large), start=1
        ):
            folder.save(trial, result)
            if count in NUMBERS:
                ran.append(psutil.Process().memory_info().rss / 1e6)
    print(*ran)
    # Once before: what is imported and cached on the way does not count.
    for number in (NUMBERS[0], *NUMBERS):
        tracemalloc.start()
        conclude(planned(number), folder, Silent())
        concluded.append(tracemalloc.get_traced_memory()[1] / 1e6)
        tracemalloc.stop()
    print(*concluded[1:])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
