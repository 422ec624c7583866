"""Part ``recording``: the smoothers over the main recording, with all tracks."""

from typing import Any

from benchmarks.smoothing import Smoothed, smoothed
from benchmarks.timing import Drive, Part, milliseconds
from vislam.estimators.smoother import SmootherOptions
from vislam.estimators.smoother.family import MEMBERS

MEAN_TARGET, TOTAL_TARGET = 0.015, 20.0
"""Longest mean step, and longest time of all steps and the final estimate [s]."""
TENTH_TARGET, OUTSIDE_TARGET = 2.0, 0.25
"""Most of the last tenth over the first, and largest share of the time outside GTSAM's solver."""
MARGINALS_TARGET = 30.0
"""Longest time of the covariances of all poses and landmarks [s]."""

RUNS: dict[str, dict[str, Any]] = {
    "isam2": {},
    "isam2, robust: cauchy": {"robust": "cauchy"},
    "isam2, marginals: all": {"marginals": "all"},
    "batch": dict(MEMBERS["batch"]),
    "batch_gnc": dict(MEMBERS["batch_gnc"]),
}
"""What is run, and its options."""


def measure(drive: Drive) -> Part:
    """Run each member once."""
    runs = {name: smoothed(drive, SmootherOptions(**options)) for name, options in RUNS.items()}
    # At least a microsecond, so that a ratio on a tiny drive is one.
    marginals = max(runs["isam2, marginals: all"].final_time - runs["isam2"].final_time, 1e-6)
    return Part(
        title=f"recording: {drive.name}, {len(drive.dataset.sequence)} frames, 1 thread",
        header=[
            "member",
            "step, mean [ms] (/target)",
            "all steps [s]",
            "final [s]",
            "total [s] (/target)",
            "last tenth/first",
            "outside GTSAM",
            "rescues",
        ],
        rows=[_row(name, run) for name, run in runs.items()],
        notes=(
            f"covariances of all poses and landmarks: {marginals:.1f} s on top "
            f"({marginals / MARGINALS_TARGET:.2f} of the target)",
            f"targets: mean step <= {1e3 * MEAN_TARGET:g} ms, total <= {TOTAL_TARGET:g} s, last tenth <= "
            f"{TENTH_TARGET:g} times the first, outside <= {100 * OUTSIDE_TARGET:g} %, covariances <= "
            f"{MARGINALS_TARGET:g} s; for isam2. Outside GTSAM: all but its updates and the reading of its "
            "estimates; building the factors counts as outside.",
        ),
        values={
            "marginals_s": marginals,
            "marginals_of_target": marginals / MARGINALS_TARGET,
            "runs": {name: _values(run) for name, run in runs.items()},
        },
    )


def _row(name: str, run: Smoothed) -> list[str]:
    mean, total = run.step_time.mean(), run.forward + run.final_time
    return [
        name,
        f"{milliseconds(mean)} ({mean / MEAN_TARGET:.2f})",
        f"{run.forward:.2f}",
        f"{run.final_time:.2f}",
        f"{total:.2f} ({total / TOTAL_TARGET:.2f})",
        f"{run.last_of_first:.2f}",
        f"{100 * run.outside:.0f} %",
        f"{run.estimate.counts['rescues']}",
    ]


def _values(run: Smoothed) -> dict[str, Any]:
    mean, total = float(run.step_time.mean()), run.forward + run.final_time
    return {
        "step_mean_s": mean,
        "step_mean_of_target": mean / MEAN_TARGET,
        "forward_s": run.forward,
        "final_s": run.final_time,
        "total_s": total,
        "total_of_target": total / TOTAL_TARGET,
        "last_tenth_ratio": run.last_of_first,
        "outside_share": run.outside,
        "outside_of_target": run.outside / OUTSIDE_TARGET,
        "rescues": run.estimate.counts["rescues"],
        "events": list(run.estimate.events),
    }
