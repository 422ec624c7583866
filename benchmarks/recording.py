"""Part ``recording``: forward and backward pass over the main recording, and what threads do to them."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.timing import MEMBERS, Drive, Part, Timed, milliseconds, quickest, timed

FORWARD_TARGET = BACKWARD_TARGET = 2.5
"""Longest that a pass over the recording should take [s]."""


def members(drive: Drive, *, repeats: int) -> dict[str, Timed]:
    """Run each member with one thread, some times, and keep the least times."""
    with threadpool_limits(1):
        return {
            name: quickest([timed(drive, options) for _ in range(repeats)])
            for name, options in MEMBERS.items()
        }


def measure(drive: Drive, runs: Mapping[str, Timed], *, few: int) -> Part:
    """Table of the members' ``runs``; two threads are tried on the first ``few`` frames only.

    Two libraries with threads of their own each, numpy's and scipy's, can wait for each other for so long
    that the whole recording would take minutes.
    """
    beginning = drive.first(few)
    rows, values = [], {}
    for name, run in runs.items():
        one, two = (_with_threads(beginning, name, threads) for threads in (1, 2))
        forward, backward = two.forward / one.forward, two.backward / one.backward
        rows.append(
            [
                name,
                f"{run.forward:.2f} ({run.forward / FORWARD_TARGET:.2f})",
                f"{run.backward:.2f} ({run.backward / BACKWARD_TARGET:.2f})",
                milliseconds(float(np.median(run.step_time))),
                f"{run.memory / 1e6:.0f}",
                f"{forward:.2f}",
                f"{backward:.2f}",
            ]
        )
        values[name] = _values(run, few=len(beginning.dataset.sequence), forward=forward, backward=backward)
    return Part(
        title=f"recording: {drive.name}, {len(drive.dataset.sequence)} frames, 1 BLAS thread",
        header=[
            "member",
            "forward [s] (/target)",
            "backward [s] (/target)",
            "step, median [ms]",
            "held [MB]",
            "2 threads/1, forward",
            "2 threads/1, backward",
        ],
        rows=rows,
        notes=(
            f"targets: forward <= {FORWARD_TARGET:g} s, backward <= {BACKWARD_TARGET:g} s; held: for the "
            f"backward pass. Two threads: time by the clock on the wall, on the first {few} frames.",
        ),
        values=values,
    )


def _with_threads(drive: Drive, name: str, threads: int) -> Timed:
    with threadpool_limits(threads):
        return timed(drive, MEMBERS[name], clock=time.perf_counter)


def _values(run: Timed, *, few: int, forward: float, backward: float) -> dict[str, Any]:
    return {
        "forward_s": run.forward,
        "forward_of_target": run.forward / FORWARD_TARGET,
        "backward_s": run.backward,
        "backward_of_target": run.backward / BACKWARD_TARGET,
        "step_median_s": float(np.median(run.step_time)),
        "held_bytes": run.memory,
        "frames": len(run.sizes),
        "frames_with_two_threads": few,
        "two_threads_forward": forward,
        "two_threads_backward": backward,
    }
