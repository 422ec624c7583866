"""``python -m experiments.smoother_end CONFIG...``: what the end of iSAM2 costs, in CPU time of one run.

The graph of the end is solved by GTSAM with each ordering and factorisation, and by our own factorisation;
the covariances of all poses and landmarks are read from GTSAM one by one, and from our own in one pass. It
measures, never asserts. Exit codes: 0 done, 2 bad arguments or data.
"""

import argparse
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import gtsam
import numpy as np
from threadpoolctl import threadpool_limits

from experiments.inside_gtsam import smoothed
from experiments.timing import CONFIGS, Drive, Part, tell
from vislam.base.types import Array
from vislam.cli.command import answer
from vislam.estimators.smoother import SmootherOptions, batch
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.system import Marginals


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit code."""
    parser = argparse.ArgumentParser(prog="python -m experiments.smoother_end", description=__doc__)
    parser.add_argument("config", type=Path, nargs="*", default=[CONFIGS / "ds3.yaml"], help="YAML files")
    parser.add_argument("--out", type=Path, metavar="FILE.json", help="file to write all numbers to")
    options = parser.parse_args(arguments)
    parts = {path.stem: partial(end, path) for path in options.config}
    return answer(lambda: _measure(parts, options.out), verbose=False)


def _measure(parts: Mapping[str, Callable[[], Part]], out: Path | None) -> int:
    tell(parts, out=out)
    return 0


def end(config: Path) -> Part:
    """Run iSAM2 over a drive and solve the graph of its end in all ways."""
    drive, kept = Drive.open(config), []
    marginals = batch.Drive.marginals

    def keep(held: batch.Drive, values: gtsam.Values, *rest: Any, **more: Any) -> Marginals:
        kept.append((held, values))
        return marginals(held, values, *rest, **more)

    with patch.object(batch.Drive, "marginals", keep):
        run = smoothed(drive, SmootherOptions(marginals="all"))
    with threadpool_limits(1):
        seconds, apart = _ways(*kept[0])
    seconds = {"all steps": float(run.step_time.sum()), "the end": run.final_time, **seconds}
    base = seconds["GTSAM, Cholesky, COLAMD"]
    return Part(
        title=f"end of isam2: {drive.name}, {len(drive.sequence)} frames",
        header=["what", "CPU [s]", "of GTSAM's Cholesky"],
        rows=[[what, f"{each:.3f}", f"{each / base:.2f}"] for what, each in seconds.items()],
        notes=(f"our covariances differ from GTSAM's by at most {apart:.1e} of the variances",),
        values={**seconds, "apart": apart},
    )


def _ways(held: batch.Drive, values: gtsam.Values) -> tuple[dict[str, float], float]:
    """CPU time of each way to solve a graph, and of all covariances [s]; and how far these are apart."""
    graph = held.graph()
    seconds: dict[str, float] = {}

    def timed(what: str, call: Callable[[], Any]) -> Any:
        before = time.thread_time()
        found = call()
        seconds[what] = time.thread_time() - before
        return found

    orderings = {
        "COLAMD": gtsam.Ordering.ColamdGaussianFactorGraph,
        "METIS": gtsam.Ordering.MetisGaussianFactorGraph,
    }
    for name, ordering in orderings.items():
        timed(f"GTSAM, Cholesky, {name}", partial(_solved, graph, values, ordering))
    timed("GTSAM, QR, COLAMD", partial(_tree_by_qr, graph, values))
    system = timed("ours", lambda: held.system(values))
    found = timed("ours, all covariances", system.marginals)
    solver = timed("GTSAM, Marginals", lambda: gtsam.Marginals(graph, values))
    keys = [*(X(k) for k in range(len(held.frames))), *(track.key for track in held.tracks)]
    one = timed("GTSAM, all covariances", lambda: [solver.marginalCovariance(key) for key in keys])
    ours = [*found.poses, *found.points]
    return seconds, max(_relative(own, each) for own, each in zip(ours, one, strict=True))


def _solved(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, ordering: Callable[[Any], gtsam.Ordering]
) -> gtsam.VectorValues:
    linear = graph.linearize(values)
    return linear.eliminateMultifrontal(ordering(linear)).optimize()


def _tree_by_qr(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.ISAM2:
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")
    tree = gtsam.ISAM2(parameters)
    tree.update(graph, values)
    return tree


def _relative(found: Array, wanted: Array) -> float:
    sigma = np.sqrt(np.diagonal(wanted))
    return float(np.abs((found - wanted) / np.outer(sigma, sigma)).max())


if __name__ == "__main__":
    sys.exit(main())
