"""Metrics of runs against a reference and against each other."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import combinations
from typing import Protocol

import numpy as np

from vislam.data.reference import Reference
from vislam.evaluation import trajectory
from vislam.evaluation.alignment import align, find_alignment
from vislam.evaluation.association import associate
from vislam.evaluation.kitti import kitti_drift
from vislam.geometry import se3
from vislam.record import Record
from vislam.run import Run
from vislam.types import Array

_SPEED_KEYS = {"step_time_p50_ms": 50.0, "step_time_p95_ms": 95.0}


@dataclass(frozen=True)
class Metric:
    """One number, kept in full.

    Attributes
    ----------
    estimator : str
        Name of the run; ``a|b`` for a comparison of two.
    key, unit : str
    value : float
    against : str
        The reference it was measured against; empty if none was needed.
    """

    estimator: str
    key: str
    value: float
    unit: str
    against: str = ""


class Statistic(Protocol):
    """A number whose distribution is known if the run is consistent."""

    @property
    def name(self) -> str:
        """What it is of."""
        ...

    @property
    def value(self) -> float:
        """The number itself."""
        ...

    @property
    def freedom(self) -> int:
        """Degrees of freedom of a sample."""
        ...

    @property
    def samples(self) -> int:
        """How many samples it is made of."""
        ...

    @property
    def effective_samples(self) -> float:
        """How many independent samples would tell as much."""
        ...

    @property
    def convention(self) -> str:
        """How it is defined."""
        ...

    def interval(self, probability: float) -> tuple[float, float]:
        """Two-sided interval in which a consistent run's is with this probability."""
        ...

    def p_value(self) -> float:
        """Chance, two-sided, that a consistent run's is as far off."""
        ...


@dataclass(frozen=True)
class Evaluation:
    """All metrics, and all statistics by run and name, with look-up."""

    metrics: Sequence[Metric]
    statistics: Mapping[tuple[str, str], Statistic] = field(default_factory=dict)

    def value(self, estimator: str, key: str) -> float | None:
        """Value of a metric, or None where it does not exist."""
        return next((m.value for m in self.metrics if (m.estimator, m.key) == (estimator, key)), None)

    def statistic(self, estimator: str, name: str) -> Statistic | None:
        """Look a statistic up; None where it does not exist."""
        return self.statistics.get((estimator, name))

    def records(self) -> list[dict[str, object]]:
        """Plain data for JSON."""
        return [asdict(metric) for metric in self.metrics]


def headline(reference: Reference) -> str:
    """Key of the error that says how right a run is: the ATE, planar where the reference is [m]."""
    return "ate_planar_rmse" if reference.planar else "ate_rmse"


def evaluate(runs: Mapping[str, Run], record: Record) -> Evaluation:
    """Score runs, in their order.

    Parameters
    ----------
    runs : mapping of name to Run
        Incomplete runs are scored on the frames they finished.
    record : Record
        Of the drive behind them.
    """
    reference = record.reference
    metrics: list[Metric] = []
    # What is planar, or a height, is so against the vertical, where a run knows it.
    for run in (run.levelled() for run in runs.values()):
        if len(run.stamp) < 2:
            continue
        if reference is not None:
            metrics += _against_reference(run, reference)
        metrics += _of_itself(run)
    for one, other in combinations(runs.values(), 2):
        metrics += _between(one, other)
    return Evaluation(metrics)


def _against_reference(run: Run, reference: Reference) -> list[Metric]:
    name = reference.name
    found = []
    for suffix, poses in (("", run.world_T_imu), ("_causal", run.world_T_imu_causal)):
        matched = associate(run.frame, run.stamp, poses, reference)
        if len(matched.frame) < 3:
            continue
        planar = trajectory.ate(matched, find_alignment("planar", matched))
        found.append(Metric(run.name, f"ate_planar_rmse{suffix}", planar.position.rmse, "m", name))
        if not reference.planar:
            full = trajectory.ate(matched, find_alignment("se3", matched))
            found.append(Metric(run.name, f"ate_rmse{suffix}", full.position.rmse, "m", name))
        drift = kitti_drift(matched)
        if drift is not None:
            found.append(Metric(run.name, f"kitti_t_rel{suffix}", drift.t_rel, "%", name))
            found.append(Metric(run.name, f"kitti_r_rel{suffix}", drift.r_rel, "deg/100m", name))
    return found + _map_error(run, reference)


def _map_error(run: Run, reference: Reference) -> list[Metric]:
    """Distance of landmarks to their true points, with the first pose laid on the true one.

    Not with the trajectory's alignment: that of a straight drive leaves the turn about it free.
    """
    common, own, true = np.intersect1d(run.track, reference.track, return_indices=True)
    if not len(common):
        return []
    assert reference.pose is not None
    start = reference.pose[0] @ se3.inverse(run.world_T_imu[0])
    moved = se3.transform(start, run.points_world[own])
    distance = np.linalg.norm(moved - reference.points_world[true], axis=1)
    return [Metric(run.name, "map_error_median", float(np.median(distance)), "m", reference.name)]


def _of_itself(run: Run) -> list[Metric]:
    metrics = [
        Metric(run.name, "path_length", trajectory.path_length(run.world_T_imu), "m"),
        Metric(run.name, "height_end", float(run.world_T_imu[-1, 2, 3]), "m"),
    ]
    if run.dof.sum() > 0:
        metrics.append(Metric(run.name, "nis_per_dof", run.nis_per_dof, "1"))
    metrics.append(Metric(run.name, "frames", float(len(run.stamp)), "1"))
    if not len(run.step_time):
        # From elsewhere: nobody knows how it was made.
        return metrics
    for key, percentile in _SPEED_KEYS.items():
        metrics.append(Metric(run.name, key, float(1e3 * np.percentile(run.step_time, percentile)), "ms"))
    metrics += [
        Metric(run.name, "total_time_s", run.total_time, "s"),
        Metric(run.name, "peak_rss_mb", run.peak_rss / 1e6, "MB"),
        Metric(run.name, "landmarks", float(len(run.track)), "1"),
        Metric(run.name, "observations_used", float(run.used.sum()), "1"),
        Metric(run.name, "observations_gated", float(run.gated.sum()), "1"),
    ]
    return metrics


def _between(one: Run, other: Run) -> list[Metric]:
    """How far two runs are apart: poses aligned by nothing but their common start, and maps."""
    frames = min(len(one.stamp), len(other.stamp))
    if frames < 3:
        return []
    pair = f"{one.name}|{other.name}"
    apart = one.world_T_imu[:frames, :3, 3] - other.world_T_imu[:frames, :3, 3]
    metrics = [Metric(pair, "trajectory_distance_rmse", _rms(apart), "m")]
    rotation, translation = align(other.world_T_imu[:frames, :3, 3], one.world_T_imu[:frames, :3, 3])
    moved = other.world_T_imu[:frames, :3, 3] @ rotation.T + translation
    metrics.append(
        Metric(pair, "trajectory_distance_aligned_rmse", _rms(one.world_T_imu[:frames, :3, 3] - moved), "m")
    )
    common, first, second = np.intersect1d(one.track, other.track, return_indices=True)
    if len(common):
        pose = se3.from_rotation_translation(rotation, translation)
        gap = one.points_world[first] - se3.transform(pose, other.points_world[second])
        metrics += [
            Metric(pair, "landmarks_common", float(len(common)), "1"),
            Metric(pair, "map_distance_median", float(np.median(np.linalg.norm(gap, axis=1))), "m"),
        ]
    return metrics


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
