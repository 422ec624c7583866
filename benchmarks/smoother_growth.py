"""Part ``growth``: whether a step of iSAM2 late in a long drive costs more than one early in it."""

import logging
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context

import numpy as np

from benchmarks.growth import give_back, simulated_config
from benchmarks.smoothing import smoothed
from benchmarks.timing import Drive, Part, milliseconds
from vislam.base.memory import PeakMemory
from vislam.estimators.smoother import SmootherEstimator, SmootherOptions

FRAMES = (1_000, 3_000, 10_000)
TARGET = 0.5
"""By how much a late step should cost more at most than an early one."""
LOSS = 0.1
"""Chance that a track is lost in a frame, with which tracks are as long as recorded ones: seen at a frame, a
track of 03.npz has 9.2 views in the mean, one of these drives 10.2."""
_WARM = 200
"""First frames, of which no window is."""


@dataclass(frozen=True)
class Growth:
    """What iSAM2 over a simulated drive cost.

    Attributes
    ----------
    frames : int
    early_s, late_s, overall_s : float
        Mean time of the steps of the first window, of the last one, and of all [s].
    early_outside_s, late_outside_s : float
        Of the same windows, the time outside GTSAM's solver [s].
    final_s : float
        Time of the final estimate [s].
    early_seen, late_seen : float
        Mean number of tracks in view in the windows.
    memory : int
        By how much the steps grew the resident memory [bytes].
    rescues : int
    events : tuple of str
    """

    frames: int
    early_s: float
    late_s: float
    overall_s: float
    early_outside_s: float
    late_outside_s: float
    final_s: float
    early_seen: float
    late_seen: float
    memory: int
    rescues: int
    events: tuple[str, ...]


def measure(*, frames: Sequence[int] = FRAMES, window: int = 500, warm: int = _WARM) -> Part:
    """Run each drive in a process of its own, whose memory nothing else has touched."""
    with ProcessPoolExecutor(
        1,
        mp_context=get_context("spawn"),
        max_tasks_per_child=1,
        initializer=logging.disable,
        initargs=(logging.WARNING,),
    ) as pool:
        count = len(frames)
        found = list(pool.map(forward, sorted(frames), [window] * count, [warm] * count))
    return Part(
        title="growth: isam2 over simulated drives, mean time of a step",
        header=[
            "frames",
            "all [ms]",
            "early [ms]",
            "late [ms]",
            "late/early",
            "outside GTSAM, early, late [ms]",
            "tracks in view, early, late",
            "final [s]",
            "memory [MB]",
            "a frame [kB]",
            "events",
        ],
        rows=[
            [
                f"{each.frames}",
                milliseconds(each.overall_s),
                milliseconds(each.early_s),
                milliseconds(each.late_s),
                f"{each.late_s / each.early_s:.2f}",
                f"{milliseconds(each.early_outside_s)}, {milliseconds(each.late_outside_s)}",
                f"{each.early_seen:.0f}, {each.late_seen:.0f}",
                f"{each.final_s:.2f}",
                f"{each.memory / 1e6:.0f}",
                f"{each.memory / each.frames / 1e3:.1f}",
                f"{len(each.events)}",
            ]
            for each in found
        ],
        notes=(
            f"early: {window} steps after the first {warm} (as far as there are); "
            f"late: the last {window}; target: within {100 * TARGET:.0f} %",
            *(f"{each.frames} frames: {event}" for each in found for event in each.events[:3]),
        ),
        values={
            "window": window,
            "runs": [
                {
                    **asdict(each),
                    "late_ratio": each.late_s / each.early_s,
                    "memory_a_frame": each.memory / each.frames,
                }
                for each in found
            ],
        },
    )


def forward(frames: int, window: int, warm: int) -> Growth:
    """Simulate a drive and smooth it, in this process."""
    drive = Drive.open(simulated_config(frames, loss_probability=LOSS))
    before, peak = PeakMemory(), PeakMemory()

    def watch(k: int, solver: SmootherEstimator) -> None:
        del solver
        if k == 0:
            # By now there is all that does not grow.
            give_back()
            with before:
                pass
            peak.__enter__()
        elif k == frames - 1:
            peak.__exit__(None, None, None)

    run = smoothed(drive, SmootherOptions(), on_frame=watch)
    first, last = slice(warm, warm + window), slice(-window, None)
    outside = run.step_time - run.solver_time
    seen = np.diff(drive.dataset.sequence.offset)
    return Growth(
        frames=frames,
        early_s=float(run.step_time[first].mean()),
        late_s=float(run.step_time[last].mean()),
        overall_s=float(run.step_time.mean()),
        early_outside_s=float(outside[first].mean()),
        late_outside_s=float(outside[last].mean()),
        final_s=run.final_time,
        early_seen=float(seen[first].mean()),
        late_seen=float(seen[last].mean()),
        memory=peak.peak - before.peak,
        rescues=run.estimate.counts["rescues"],
        events=run.estimate.events,
    )
