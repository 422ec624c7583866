"""Part ``growth``: whether a step late in a long drive costs more time than an early one, and the memory.

Each run is a process of its own, whose memory nothing else has touched. What grows with the drive by its
nature, the poses and landmarks that the filter gives in the end, is in the memory.
"""

import contextlib
import ctypes
import gc
import logging
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context

import numpy as np
from threadpoolctl import threadpool_limits

from experiments.inside_gtsam import smoothed
from experiments.timing import Drive, Part, milliseconds
from vislam.base.memory import PeakMemory
from vislam.base.types import Array
from vislam.comparison.config import Config, DataConfig, NoiseConfig
from vislam.estimators.ekf import EkfEstimator, EkfOptions
from vislam.estimators.smoother import SmootherOptions
from vislam.estimators.smoother.family import VARIANTS
from vislam.repair import RepairConfig
from vislam.simulation import SimulationConfig

DRIVES: Mapping[str, Sequence[int]] = {"ekf": (1_000, 10_000), "isam2": (1_000, 3_000)}
"""Frames of the drives of each estimator; the graph of isam2 grows by a megabyte a frame."""
NAMES = ("ekf", *VARIANTS)
"""Estimators that can be run."""
TRACKS = 66.0
"""Tracks in view; with these, tracks are as dense as recorded ones."""
_SIMULATION = SimulationConfig(
    # With this, tracks are as long as recorded ones: seen at a frame, one of 03.npz has 9.2 views, here 10.2.
    loss_probability=0.1,
    pixel_sigma_px=0.3,
    drift_px=0.1,
    matching_bias_px=0.4,
    gyro_bias=(0.003, -0.002, 0.004),
)


@dataclass(frozen=True)
class Growth:
    """What an estimator's steps over a simulated drive cost.

    Attributes
    ----------
    estimator : str
    frames : int
    early_s, late_s : float
        Mean time of a step, of an early window of the drive and of its end [s].
    memory : int
        By how much the steps grew the resident memory [bytes].
    """

    estimator: str
    frames: int
    early_s: float
    late_s: float
    memory: int

    @property
    def ratio(self) -> float:
        """Time of a late step over that of an early one."""
        return self.late_s / self.early_s


def growth(drives: Mapping[str, Sequence[int]], *, window: int, warm: int, tracks: float = TRACKS) -> Part:
    """Run the estimators over their drives; the first window begins after ``warm`` frames."""
    jobs = [(name, frames, window, warm, tracks) for name, each in drives.items() for frames in each]
    with ProcessPoolExecutor(
        1,
        mp_context=get_context("spawn"),
        max_tasks_per_child=1,
        initializer=logging.disable,
        initargs=(logging.WARNING,),
    ) as pool:
        found = list(pool.map(grown, *zip(*jobs, strict=True)))
    return Part(
        title=f"growth: simulated drives, {tracks:g} tracks in view, mean time of a step",
        header=["estimator", "frames", "early [ms]", "late [ms]", "late/early", "memory a frame [kB]"],
        rows=[
            [
                each.estimator,
                f"{each.frames}",
                milliseconds(each.early_s),
                milliseconds(each.late_s),
                f"{each.ratio:.2f}",
                f"{each.memory / each.frames / 1e3:.1f}",
            ]
            for each in found
        ],
        notes=(f"early: {window} steps after the first {warm}; late: the last {window}",),
        values={"window": window, "runs": [{**asdict(each), "late_ratio": each.ratio} for each in found]},
    )


def grown(estimator: str, frames: int, window: int, warm: int, tracks: float = TRACKS) -> Growth:
    """Simulate a drive and run an estimator over it, in this process."""
    drive = Drive.open(drive_config(frames, tracks))
    before, peak = PeakMemory(), PeakMemory()

    def watch(k: int) -> None:
        if k == 0:
            # By now there is all that does not grow.
            give_back()
            with before:
                pass
            peak.__enter__()
        elif k == frames - 1:
            peak.__exit__(None, None, None)

    if estimator == "ekf":
        times = _filtered(drive, watch)
    else:
        times = smoothed(drive, SmootherOptions(**VARIANTS[estimator]), on_frame=watch).step_time
    early, late = times[warm : warm + window].mean(), times[-window:].mean()
    return Growth(estimator, frames, float(early), float(late), peak.peak - before.peak)


def _filtered(drive: Drive, watch: Callable[[int], None]) -> Array:
    solver = EkfEstimator(drive.problem, EkfOptions(marginalised_landmarks="filtered"))
    times = []
    with threadpool_limits(1):
        for frame in drive.sequence.frames(drive.sigma):
            before = time.thread_time()
            solver.process(frame)
            times.append(time.thread_time() - before)
            watch(frame.k)
    return np.array(times)


def give_back() -> None:
    """Return freed memory to the system, where the C library can, so that none is taken from it unseen."""
    gc.collect()
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def drive_config(frames: int, tracks: float) -> Config:
    """Config of a drive through a town, with the noise that the estimators assume."""
    simulation = replace(_SIMULATION, frames=frames, tracks_in_view=tracks)
    root = np.sqrt(simulation.period)
    turn, slip = simulation.gyro_sigma * root, simulation.velocity_sigma * root
    return Config(
        name=f"town-{frames}",
        data=DataConfig(simulation=simulation, repair=RepairConfig(consensus=None)),
        noise=NoiseConfig(
            pixel_sigma_px=simulation.pixel_sigma_px,
            drift_px=simulation.drift_px,
            matching_bias_px=simulation.matching_bias_px,
            twist_density=(turn, turn, turn, slip, slip, slip),
        ),
    )
