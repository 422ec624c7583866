"""GTSAM's own smoothers on the factors and first values that ours are given, frame by frame.

Ours are built on the same library, so that what is compared is how it is used: order of elimination,
factorisation, relinearisation, and what is outside of GTSAM. Times are CPU times of one thread.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any
from unittest.mock import patch

import gtsam
import numpy as np
from threadpoolctl import threadpool_limits

from experiments.battle import armse_of
from experiments.timing import Drive
from vislam.base.types import Array, BoolArray
from vislam.comparison.compare import gateless
from vislam.core.step import Final
from vislam.estimators.smoother import SmootherEstimator, SmootherOptions, engine
from vislam.estimators.smoother.family import VARIANTS
from vislam.estimators.smoother.keys import X


@dataclass(frozen=True)
class Given:
    """What an engine was given with a frame: factors, first values, times of keys, factors taken out."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    stamps: dict[int, float]
    remove: list[int]


@dataclass
class Ours:
    """A run of ours with all that its engine was given.

    Attributes
    ----------
    given : list of Given
        ``remove`` counts all factors given so far.
    poses : (T, 4, 4)
        Filtered.
    final : Final
    steps_s, end_s : float
        CPU time of the steps and of the end [s].
    """

    given: list[Given]
    poses: Array = field(default_factory=lambda: np.empty((0, 4, 4)))
    final: Final | None = None
    steps_s: float = 0.0
    end_s: float = 0.0


@dataclass(frozen=True)
class Found:
    """Poses ``(T, 4, 4)`` of a solver and its CPU time [s], or why it broke off."""

    poses: Array
    seconds: float
    error: str = ""


def run_ours(drive: Drive, options: SmootherOptions, usable: BoolArray) -> Ours:
    """Run one of ours over a drive's usable observations, and keep what its engine is given."""
    solver, found = SmootherEstimator(gateless(drive.problem), options), Ours([])
    with threadpool_limits(1), _kept(found.given):
        before = time.thread_time()
        poses = [solver.process(frame).pose for frame in drive.sequence.frames(drive.sigma, usable)]
        found.steps_s = time.thread_time() - before
        before = time.thread_time()
        found.final = solver.finalize()
        found.end_s = time.thread_time() - before
    found.poses = np.array(poses)
    return found


@contextmanager
def _kept(given: list[Given]) -> Iterator[None]:
    """Keep what engines are given."""
    places: dict[int, int] = {}

    def keeping(update: Callable[..., list[int]]) -> Callable[..., list[int]]:
        def kept(
            self: Any,
            graph: gtsam.NonlinearFactorGraph,
            values: gtsam.Values,
            *,
            stamps: dict[int, float],
            remove: Sequence[int],
            **rest: Any,
        ) -> list[int]:
            gone = [places[slot] for slot in remove if slot in places]
            given.append(Given(graph, values, dict(stamps), gone))
            slots = update(self, graph, values, stamps=stamps, remove=remove, **rest)
            first = len(places)
            places.update(zip(slots, range(first, first + len(slots)), strict=True))
            return slots

        return kept

    with (
        patch.object(engine.WholeGraph, "update", keeping(engine.WholeGraph.update)),
        patch.object(engine.FixedLag, "update", keeping(engine.FixedLag.update)),
    ):
        yield


def window(smoother: Any, given: Sequence[Given]) -> Found:
    """Run a fixed-lag smoother of GTSAM, as it comes; landmarks that ours rejected later stay."""
    poses, before = [], time.thread_time()
    for k, one in enumerate(given):
        try:
            smoother.update(one.graph, one.values, one.stamps)
            poses.append(smoother.calculateEstimatePose3(X(k)).matrix())
        except RuntimeError as error:
            first = next(line.strip() for line in str(error).splitlines() if line.strip())
            return Found(np.array(poses).reshape(-1, 4, 4), time.thread_time() - before, first)
    return Found(np.array(poses), time.thread_time() - before)


def batch(given: Sequence[Given]) -> Found:
    """Optimise all factors from their first values by GTSAM's Levenberg-Marquardt, as it comes."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    for one in given:
        graph.push_back(one.graph)
        values.insert(one.values)
    for one in given:
        for place in one.remove:
            graph.remove(place)
    before = time.thread_time()
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    spent = time.thread_time() - before
    return Found(np.array([found.atPose3(X(k)).matrix() for k in range(len(given))]), spent)


def lines(drive: Drive, usable: BoolArray, target: Array, *, lag_s: float) -> Iterator[str]:
    """Rows of the table; ``target (T, 4, 4)`` are the reference's poses of the body at all frames."""
    # Of a window that is rebuilt to relinearise it there is more than one update a frame.
    lag = {**VARIANTS["fixed_lag"], "lag_s": lag_s, "relinearize_beyond": None}
    lagged = run_ours(drive, SmootherOptions(**lag), usable)
    whole = run_ours(drive, SmootherOptions(**VARIANTS["batch"]), usable)
    assert whole.final is not None
    assert whole.final.trajectory is not None
    ours, smoothed = Found(lagged.poses, lagged.steps_s), whole.final.trajectory.world_T_imu
    ended = Found(smoothed, whole.end_s)
    incremental = gtsam.IncrementalFixedLagSmoother(lag_s, gtsam.ISAM2Params())
    by_batches = gtsam.BatchFixedLagSmoother(lag_s, gtsam.LevenbergMarquardtParams())
    rows = (
        (f"`fixed_lag`, {lag_s:g} s, filtered", ours, ours),
        ("GTSAM `IncrementalFixedLagSmoother`, filtered", window(incremental, lagged.given), ours),
        ("GTSAM `BatchFixedLagSmoother`, filtered", window(by_batches, lagged.given), ours),
        ("`batch`, its end", ended, ended),
        ("GTSAM `LevenbergMarquardtOptimizer`", batch(whole.given), ended),
    )
    yield ""
    yield "| | position ARMSE [m] | farthest from ours [m] | CPU [s] | times ours |"
    yield "|---|---:|---:|---:|---:|"
    for name, found, beside in rows:
        yield _line(name, found, beside, target, drive.problem.rig.imu_T_cam)


def _line(name: str, found: Found, beside: Found, target: Array, imu_T_cam: Array) -> str:
    if found.error:
        return f"| {name} | broke off at frame {len(found.poses)}: {found.error} | | {found.seconds:.2f} | |"
    apart = np.linalg.norm(found.poses[:, :3, 3] - beside.poses[:, :3, 3], axis=1).max()
    error, _ = armse_of(found.poses @ imu_T_cam, target @ imu_T_cam)
    ratio = found.seconds / beside.seconds
    return f"| {name} | {error:.3f} | {apart:.2g} | {found.seconds:.2f} | {ratio:.1f} |"
