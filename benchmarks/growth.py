"""Part ``growth``: whether a step of a long drive costs more time and memory than one of a short drive."""

import contextlib
import ctypes
import gc
import logging
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, fields, replace
from multiprocessing import get_context

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.timing import Drive, Part, milliseconds
from vislam.base.memory import PeakMemory
from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.repair import RepairConfig
from vislam.simulation import SimulationConfig

FRAMES = (1_000, 3_000, 10_000)
TARGET = 0.1
"""By how much a step of a longer drive should cost more at most than one of the shortest."""
MODES: Mapping[str, EkfOptions] = {
    "64 MB": EkfOptions(memory_mb=64),
    "as_left": EkfOptions(finished="as_left"),
}
_QUIET = 10
_SIMULATION = SimulationConfig(
    tracks_in_view=66.0,
    pixel_sigma_px=0.3,
    drift_px=0.1,
    match_px=0.4,
    gyro_bias=(0.003, -0.002, 0.004),
)


@dataclass(frozen=True)
class Growth:
    """What a forward pass over a simulated drive cost.

    Attributes
    ----------
    mode : str
    frames : int
    simulated_s : float
        Time that the simulation took [s].
    first_s, last_s, overall_s : float
        Mean time of the first steps, the last ones and all [s].
    last_quiet_s, overall_quiet_s : float
        The tenth percentile of the last steps and of all, which a busy machine moves less than the mean [s].
    landmarks : float
        Mean number in the state.
    memory : int
        By how much the forward pass grew the resident memory, without its results [bytes].
    results : int
        Memory of the results: poses, match errors and landmarks that have left [bytes].
    """

    mode: str
    frames: int
    simulated_s: float
    first_s: float
    last_s: float
    overall_s: float
    last_quiet_s: float
    overall_quiet_s: float
    landmarks: float
    memory: int
    results: int


def measure(*, frames: Sequence[int] = FRAMES, window: int = 1_000) -> Part:
    """Run each drive in each mode, in a process of its own, whose memory nothing else has touched."""
    found: list[Growth] = []
    frames = sorted(frames)
    with ProcessPoolExecutor(
        1,
        mp_context=get_context("spawn"),
        max_tasks_per_child=1,
        initializer=logging.disable,
        initargs=(logging.WARNING,),
    ) as pool:
        for mode in MODES:
            found += list(pool.map(forward, [mode] * len(frames), frames, [window] * len(frames)))
    shortest = {each.mode: each for each in reversed(found)}
    rows, values = [], []
    for each in found:
        short = shortest[each.mode]
        ratios = {
            "first_ratio": each.first_s / short.overall_s,
            "last_ratio": each.last_s / short.overall_s,
            "overall_ratio": each.overall_s / short.overall_s,
            "last_quiet_ratio": each.last_quiet_s / short.overall_quiet_s,
        }
        rows.append(
            [
                each.mode,
                f"{each.frames}",
                milliseconds(each.overall_s),
                *(f"{ratio:.2f}" for ratio in ratios.values()),
                f"{each.landmarks:.1f}",
                f"{each.memory / 1e6:.0f} + {each.results / 1e6:.0f}",
            ]
        )
        values.append({**asdict(each), **ratios})
    simulated = ", ".join(f"{each.simulated_s:.1f} s ({each.frames})" for each in found[: len(frames)])
    return Part(
        title="growth: ekf over simulated drives, mean time of a step, forward",
        header=[
            "mode",
            "frames",
            "step [ms]",
            "first",
            "last",
            "all",
            "last, quiet",
            "landmarks",
            "memory + results [MB]",
        ],
        rows=rows,
        notes=(
            f"first {window} steps, last {window} and all against those of the shortest drive; "
            f"target: within {100 * TARGET:.0f} %. Quiet: tenth percentile in place of the mean. "
            f"Simulating took {simulated}.",
        ),
        values={"window": window, "runs": values},
    )


def forward(mode: str, frames: int, window: int) -> Growth:
    """Simulate a drive and filter it forward, in this process."""
    began = time.perf_counter()
    drive = Drive.open(simulated_config(frames))
    simulated = time.perf_counter() - began
    sequence = drive.dataset.sequence
    solver = EkfEstimator(drive.problem, MODES[mode])
    refused = np.zeros(sequence.observations, bool)
    step_time, landmarks = np.zeros(len(sequence)), np.zeros(len(sequence))
    before, peak = PeakMemory(), PeakMemory()
    with threadpool_limits(1), peak:
        for frame in sequence.frames(drive.sigma):
            rows = slice(sequence.offset[frame.k], sequence.offset[frame.k + 1])
            started = time.thread_time()
            solver.process(frame, refused[rows])
            step_time[frame.k] = time.thread_time() - started
            landmarks[frame.k] = len(solver.state.track)
            if frame.k == 0:
                # By now there is all that does not grow: what the sequence makes of itself for all frames.
                give_back()
                with before:
                    pass
    first, last = step_time[:window], step_time[-window:]
    results = sum(sys.getsizeof(item) for item in _results(solver))
    return Growth(
        mode=mode,
        frames=len(sequence),
        simulated_s=simulated,
        first_s=float(first.mean()),
        last_s=float(last.mean()),
        overall_s=float(step_time.mean()),
        last_quiet_s=float(np.percentile(last, _QUIET)),
        overall_quiet_s=float(np.percentile(step_time, _QUIET)),
        landmarks=float(landmarks.mean()),
        memory=peak.peak - before.peak - results,
        results=results,
    )


def give_back() -> None:
    """Return freed memory to the system, where the C library can, so that none is taken from it unseen."""
    gc.collect()
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def _results(solver: EkfEstimator) -> Iterator[object]:
    yield from solver._poses
    yield from solver._matches
    for left in solver._left:
        yield from (getattr(left, item.name) for item in fields(left))


def simulated_config(frames: int, *, loss_probability: float | None = None) -> Config:
    """Config of a drive through a town, with the noise that the filter assumes."""
    simulation = replace(_SIMULATION, frames=frames)
    if loss_probability is not None:
        simulation = replace(simulation, loss_probability=loss_probability)
    root = np.sqrt(simulation.period)
    turn, slip = simulation.gyro_sigma * root, simulation.velocity_sigma * root
    return Config(
        name=f"town-{frames}",
        data=DataConfig(simulation=simulation, repair=RepairConfig(consensus=None)),
        noise=NoiseConfig(
            pixel_sigma_px=simulation.pixel_sigma_px,
            drift_px=simulation.drift_px,
            match_px=simulation.match_px,
            twist_density=(turn, turn, turn, slip, slip, slip),
        ),
    )
