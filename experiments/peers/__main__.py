"""Print the tables of all peers."""

import argparse
import shutil
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from threadpoolctl import threadpool_limits

import vislam
from experiments.battle import armse
from experiments.peers import evo, graphs
from experiments.peers.published import PUBLISHED, Published
from experiments.timing import Drive
from vislam.base.shipped import find_config
from vislam.base.types import Array, BoolArray
from vislam.cli.console import Terminal
from vislam.comparison.compare import gateless
from vislam.comparison.members import Unbuilt, members
from vislam.core.reference import Reference
from vislam.core.run import Run

CONFIG = "battle/kitti_0001"
LAG = "fixed_lag_10"
OURS = ("msckf", "ekf_invariant", LAG, "isam2", "batch")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ours and those that can be run, and print a table of each."""
    parser = argparse.ArgumentParser(prog="python -m experiments.peers", description=__doc__)
    parser.add_argument("--data-dir", type=Path, help="first folder to look for data")
    options = parser.parse_args(arguments)
    outcome = vislam.compare(
        CONFIG, estimators=OURS, data_dir=options.data_dir, allow_substitute=False, progress=Terminal()
    )
    record = outcome.results.record
    assert record.reference is not None
    assert record.reference.pose is not None
    path = find_config(CONFIG)
    assert path is not None
    assert record.common_set is not None
    drive, usable = Drive.open(path, data_dir=options.data_dir), record.common_set.kept
    seconds = {name: cpu(drive, name, usable) for name in OURS}
    print("\n".join(published_lines(outcome.runs, seconds, record.reference, record.rig.imu_T_cam)))
    lag = drive.config.estimators[LAG]["lag_s"]
    print("\n".join(graphs.lines(drive, usable, record.reference.pose, lag_s=lag)))
    if shutil.which(evo.APE) is None:
        print(f"\n{evo.APE} is not installed: pip install evo")
        return 0
    with TemporaryDirectory() as folder:
        compared = evo.compare(Path(folder), outcome.runs["isam2"], record.reference)
    print("\n".join(compared.lines()))
    return 0


def cpu(drive: Drive, name: str, usable: BoolArray) -> float:
    """CPU time of a whole run on one thread [s]."""
    estimator = members(drive.config)[name].build(gateless(drive.problem))
    assert not isinstance(estimator, Unbuilt)
    with threadpool_limits(1):
        before = time.thread_time()
        for frame in drive.sequence.frames(drive.sigma, usable):
            estimator.process(frame)
        estimator.finalize()
        return time.thread_time() - before


def published_lines(
    runs: Mapping[str, Run], seconds: Mapping[str, float], reference: Reference, imu_T_cam: Array
) -> Iterator[str]:
    """Rows of the table of published figures and ours."""
    yield "| | position ARMSE [m] | whole run, CPU [s] | MSCKF of Clement et al. over it |"
    yield "|---|---:|---:|---:|"
    yield from (f"| {one.name} | {one.armse:.3f} | {_seconds(one)} | |" for one in PUBLISHED)
    slow = PUBLISHED[0].seconds
    assert slow is not None
    for name, run in runs.items():
        error = armse(run, reference, imu_T_cam, estimate=run.estimates[-1])[0]
        spent = seconds[name]
        yield f"| `{name}`, {run.estimates[-1]} | {error:.3f} | {spent:.2f} | {slow / spent:.0f} |"


def _seconds(one: Published) -> str:
    return "not published" if one.seconds is None else f"{one.seconds:.0f} (another machine)"


if __name__ == "__main__":
    sys.exit(main())
