"""Scores of a run, and of two: arrays, which metrics summarise and figures show."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.own_clock import OwnClock
from vislam.core.record import Record, Tracks
from vislam.core.reference import Reference
from vislam.core.run import Beside, Estimate, Run
from vislam.core.trajectory import Poses
from vislam.evaluation import maps, normalised, smoothing
from vislam.evaluation.agreement import Agreement, agreement, shared_estimates
from vislam.evaluation.alignment import align
from vislam.evaluation.clouds import CloudErrors, cloud_errors
from vislam.evaluation.degenerate import degeneracies
from vislam.evaluation.difference import ErrorDifference, ate_difference
from vislam.evaluation.efficiency import Efficiency, efficiency
from vislam.evaluation.held_out import HeldOut, HeldOutScore, Paired, paired, score
from vislam.evaluation.lag import LagScores, score_lags
from vislam.evaluation.maps import Bin, MapDifference, MapErrors
from vislam.evaluation.metric import BESIDE_TITLES, of_beside
from vislam.evaluation.normalised import Normalised
from vislam.evaluation.smoothing import SmoothingDifference, smoothing_difference
from vislam.evaluation.statistics import Statistic, Whiteness
from vislam.evaluation.trajectory_scores import TrajectoryScores, score_trajectory
from vislam.geometry import se3

VIEWS = np.array([1.0, 3.0, 6.0, 12.0, 24.0, np.inf])
"""Bounds of the numbers of views."""
_FEWEST_COMMON = 3


@dataclass(frozen=True)
class EstimateScores:
    """Scores of one estimate of a run's trajectory.

    Attributes
    ----------
    poses : Poses
        Levelled: what is planar, or a height, is so against the vertical, where a run knows it.
    trajectory : TrajectoryScores or None
        None without a reference.
    claims : dict of str to Normalised
        Errors beside their estimated covariances, by the name of the statistic.
    fit : Statistic or None
        None for any but the final estimate.
    map : MapErrors or None
        Against true landmarks, with the first pose laid on the true one; None for any but the final estimate,
        whose landmarks they are.
    map_aligned : MapErrors or None
        The same with the alignment of the whole trajectory.
    held_out : HeldOutScore or None
        By the tracks that no estimator was given.
    degenerate : tuple of str
        Why it is no answer to the data, and not to be ranked; empty for a sound estimate.
    efficiency : Efficiency or None
        None for a drive whose bound was not computed.
    """

    poses: Poses
    trajectory: TrajectoryScores | None
    claims: Mapping[str, Normalised]
    fit: Statistic | None
    map: MapErrors | None
    map_aligned: MapErrors | None
    held_out: HeldOutScore | None
    degenerate: tuple[str, ...] = ()
    efficiency: Efficiency | None = None

    @cached_property
    def statistics(self) -> dict[str, Statistic]:
        """Every statistic whose distribution is known if the estimate is consistent, by name."""
        own = {} if self.fit is None else {"fit": self.fit}
        return own | {name: claim.statistic() for name, claim in self.claims.items()}


@dataclass(frozen=True)
class RunScores:
    """Scores of one run.

    Attributes
    ----------
    run : Run
        Levelled.
    estimates : dict of "filtered" or "smoothed" to EstimateScores
        Of each estimate that it has, the final one last.
    nis : Statistic or None
    whiteness : Whiteness or None
        Of the NIS.
    bias : Normalised or None
        Errors of the filtered bias beside what was claimed of them.
    lags : sequence of LagScores
        Of the poses as known at each lag; empty where that was not asked for.
    smoothing : SmoothingDifference or None
        Of its own filtered and smoothed poses; None unless it has covariances of both.
    own : OwnClock or None
        How a trajectory from elsewhere was matched; None for a run of the recording's frames.
    cloud : CloudErrors or None
        Its map of points against those of the reference.
    """

    run: Run
    estimates: Mapping[Estimate, EstimateScores]
    nis: Statistic | None
    whiteness: Whiteness | None
    bias: Normalised | None
    lags: Sequence[LagScores] = ()
    smoothing: SmoothingDifference | None = None
    own: OwnClock | None = None
    cloud: CloudErrors | None = None

    @property
    def final(self) -> EstimateScores:
        """Scores of the final estimate."""
        return self.estimates[self.run.estimates[-1]]

    @cached_property
    def statistics(self) -> dict[str, Statistic]:
        """Statistics of the run as a whole, by name."""
        found = {
            "nis": self.nis,
            "nees_bias": None if self.bias is None else self.bias.statistic(),
            smoothing.NAME: None if self.smoothing is None else self.smoothing.statistic(),
        }
        return {name: statistic for name, statistic in found.items() if statistic is not None}


@dataclass(frozen=True)
class EstimatePair:
    """Scores of the same estimate of two runs.

    Attributes
    ----------
    agreement : Agreement or None
        Of their poses; None where one of them claims nothing.
    agreement_considered : Agreement or None
        The same with the errors that both share; None where one of them has not considered them.
    held_out : Paired or None
    error : ErrorDifference or None
        ATE of the first less that of the second, with the alignment of the headline; None without a
        reference.
    """

    agreement: Agreement | None
    held_out: Paired | None
    error: ErrorDifference | None = None
    agreement_considered: Agreement | None = None


@dataclass(frozen=True)
class PairScores:
    """Scores of two runs.

    Attributes
    ----------
    estimates : dict of "filtered" or "smoothed" to EstimatePair
        Of each estimate that both have: one is never held against the other.
    map : MapDifference or None
        Of the maps, which are those of the final estimates.
    smoothing : SmoothingDifference or None
        Of the filtered poses of one and the smoothed of the other, if both had the same information.
    by_sum : Agreement or None
        The same two estimates by the sum of their covariances.
    depth, views : (k,)
        Depth [m] of each landmark of ``map`` from the pose that saw it first, and the number of its views.
    baseline : float
        Of the rig [m].
    cloud : CloudErrors or None
        Of their maps as points, where one is from elsewhere.
    """

    estimates: Mapping[Estimate, EstimatePair]
    map: MapDifference | None
    depth: Array
    views: IntArray
    baseline: float
    smoothing: SmoothingDifference | None = None
    by_sum: Agreement | None = None
    cloud: CloudErrors | None = None

    def by_depth(self) -> list[Bin]:
        """How far the maps are apart, by the depth of the landmarks [baselines]."""
        return self._binned(self.depth / self.baseline, maps.DEPTHS)

    def by_views(self) -> list[Bin]:
        """The same by the number of views."""
        return self._binned(self.views, VIEWS)

    def _binned(self, by: Array | IntArray, edges: Array) -> list[Bin]:
        if self.map is None:
            return []
        return maps.binned(self.map.distance, self.map.squared, by=by, edges=edges)


def fit_statistic(run: Run) -> Statistic | None:
    """Squared residuals of a final estimate; None where their sum is no chi-square number."""
    if run.fit is None or run.fit[1] <= 0:
        return None
    squares, freedom = run.fit
    return Statistic(
        name="fit",
        value=squares / freedom,
        freedom=float(freedom),
        samples=1,
        effective=1.0,
        convention="squared residuals of the final estimate, each by its noise, less the unknowns",
    )


def score_run(run: Run, record: Record, own: OwnClock | None = None) -> RunScores:
    """Score one run; one from elsewhere, against the reference, on its own clock."""
    run = run.levelled()
    true_bias = None if record.reference is None else record.reference.bias
    estimates = {estimate: _score_estimate(run, estimate, record, own) for estimate in run.estimates}
    return RunScores(
        run=run,
        estimates=estimates,
        nis=normalised.nis_statistic(run),
        whiteness=normalised.nis_whiteness(run),
        bias=None if true_bias is None else normalised.bias_errors(run, true_bias),
        lags=score_lags(run, record),
        smoothing=None if run.smoothed is None else smoothing_difference(run, run),
        own=own,
        cloud=_cloud(own, record, estimates[run.estimates[-1]].trajectory),
    )


def _cloud(own: OwnClock | None, record: Record, scored: TrajectoryScores | None) -> CloudErrors | None:
    """Points of a map from elsewhere against the true ones, laid on them by the trajectory."""
    reference = record.reference
    if own is None or own.points is None or reference is None or scored is None:
        return None
    if reference.planar or not len(reference.points_world):
        return None
    laid = scored.alignments["se3"]
    points = laid.transform_points(own.points)
    true, positions = reference.points_world, reference.position
    return cloud_errors(points, true, positions, baseline=record.rig.baseline)


def _pair_cloud(one: RunScores, other: RunScores, baseline: float) -> CloudErrors | None:
    """Points of two maps, of which one at least is from elsewhere."""
    maps_of = [
        run.run.landmarks.points_world if run.own is None or run.own.points is None else run.own.points
        for run in (one, other)
    ]
    if all(run.own is None for run in (one, other)) or not all(map(len, maps_of)):
        return None
    _, first, second = np.intersect1d(one.run.frame, other.run.frame, return_indices=True)
    if len(first) < _FEWEST_COMMON:
        return None
    positions = one.run.final.world_T_imu[first, :3, 3]
    rotation, translation = align(other.run.final.world_T_imu[second, :3, 3], positions)
    return cloud_errors(maps_of[0], maps_of[1] @ rotation.T + translation, positions, baseline=baseline)


def _score_estimate(run: Run, estimate: Estimate, record: Record, own: OwnClock | None) -> EstimateScores:
    """Score one estimate of a levelled run."""
    held, poses = record.held_out, run.poses(estimate)
    reference, scored, timed = record.reference, run, True
    if own is not None:
        reference, scored, timed = own.reference, own.run, own.timed
    final = estimate == run.estimates[-1]
    trajectory = None
    if reference is not None:
        trajectory = score_trajectory(
            scored.frame, scored.stamp, scored.poses(estimate).world_T_imu, reference, timed=timed
        )
    joined, aligned = _map_errors(run, record, trajectory) if final and own is None else (None, None)
    claims = _claims(scored, estimate, reference) if reference is not None and trajectory is not None else []
    if joined is not None and joined.normalised is not None:
        claims.append(joined.normalised)
    return EstimateScores(
        poses=poses,
        trajectory=trajectory,
        claims={claim.name: claim for claim in claims},
        fit=fit_statistic(run) if final else None,
        map=joined,
        map_aligned=aligned,
        held_out=(
            score(HeldOut(held.frame, held.track, held.z, record.rig), poses.world_T_imu, frame=run.frame)
            if len(held.track)
            else None
        ),
        degenerate=degeneracies(run, record, estimate),
        efficiency=efficiency(run, reference, record.bound, estimate),
    )


def _claims(run: Run, estimate: Estimate, reference: Reference) -> list[Normalised]:
    """Errors of the poses of an estimate beside each of the covariances that the run has."""
    found = _by_its_own(run, estimate, reference)
    for kind in run.beside:
        for claim in _beside(run, kind, estimate, reference):
            told = f"{claim.convention}; {BESIDE_TITLES[kind]}"
            found.append(replace(claim, name=of_beside(claim.name, kind), convention=told))
    return found


def _beside(run: Run, kind: Beside, estimate: Estimate, reference: Reference) -> list[Normalised]:
    """Errors beside another covariance; where worlds are aligned, so is what shared errors add."""
    if kind == "considered" and run.considered is not None and reference.pose is None:
        shared = run.considered.of(smoothed=estimate == "smoothed")
        return _by_its_own(run, estimate, reference, shared=shared)
    return _by_its_own(run.with_covariances(kind), estimate, reference)


def _by_its_own(
    run: Run, estimate: Estimate, reference: Reference, *, shared: Array | None = None
) -> list[Normalised]:
    """Errors of the poses of an estimate beside their estimated covariances."""
    if reference.pose is not None:
        return list((normalised.pose_errors(run, reference, estimate=estimate) or {}).values())
    found = normalised.position_errors(
        run,
        reference,
        planar=reference.planar,
        reference_sigma=reference.sigma,
        estimate=estimate,
        shared=shared,
    )
    return [] if found is None else [found]


def _map_errors(
    run: Run, record: Record, final: TrajectoryScores | None
) -> tuple[MapErrors | None, MapErrors | None]:
    """Landmarks against the true ones, by the first pose and by the trajectory's alignment."""
    reference = record.reference
    if final is None or reference is None or reference.pose is None or not len(reference.track):
        return None, None
    # Nobody can know the landmarks of tracks that were kept from all.
    given = np.isin(reference.track, record.given.track)
    reference = replace(reference, track=reference.track[given], points_world=reference.points_world[given])
    assert reference.pose is not None
    depth = _depth(reference.track, reference.points_world, record.given, reference.frame, reference.pose)
    found = []
    for laid in (final.alignments["first_pose"], final.alignments["se3"]):
        pose = se3.from_rotation_translation(laid.rotation, laid.translation)
        found.append(maps.map_errors(run, reference, alignment=pose, depth=depth))
    return found[0], found[1]


def score_pair(one: RunScores, other: RunScores, record: Record, *, equal: bool = False) -> PairScores:
    """Score two runs against each other; ``equal`` says whether they had the same information."""
    apart = maps.map_difference(one.run, other.run)
    depth, views = np.empty(0), np.empty(0, np.int64)
    if apart is not None:
        mapped = one.run.landmarks
        own = np.searchsorted(mapped.track, apart.track, sorter=(order := np.argsort(mapped.track)))
        points = mapped.points_world[order[own]]
        depth = _depth(apart.track, points, record.given, one.run.frame, one.run.final.world_T_imu)
        views = np.bincount(record.given.track, minlength=int(apart.track.max()) + 1)[apart.track]
    return PairScores(
        estimates={
            estimate: EstimatePair(
                agreement=agreement(one.run, other.run, estimates=(estimate, estimate)),
                held_out=_paired(one.estimates[estimate].held_out, other.estimates[estimate].held_out),
                error=_difference(one.estimates[estimate].trajectory, other.estimates[estimate].trajectory),
                agreement_considered=agreement(
                    one.run, other.run, estimates=(estimate, estimate), considered=True
                ),
            )
            for estimate in shared_estimates(one.run, other.run)
        },
        map=apart,
        depth=depth,
        views=views,
        baseline=record.rig.baseline,
        **(_smoothing(one.run, other.run) if equal else {}),
        cloud=_pair_cloud(one, other, record.rig.baseline),
    )


def _smoothing(one: Run, other: Run) -> dict[str, Any]:
    """Filtered poses of one against smoothed ones of the other, of the second if both have such."""
    first, second = (one, other) if other.smoothed is not None else (other, one)
    if second.smoothed is None:
        return {}
    found = smoothing_difference(first, second)
    by_sum = None if found is None else agreement(first, second, estimates=("filtered", "smoothed"))
    return {"smoothing": found, "by_sum": by_sum}


def _difference(one: TrajectoryScores | None, other: TrajectoryScores | None) -> ErrorDifference | None:
    return None if one is None or other is None else ate_difference(one.headline, other.headline)


def _paired(one: HeldOutScore | None, other: HeldOutScore | None) -> Paired | None:
    return None if one is None or other is None or not len(one.track) else paired(one, other)


def _depth(track: IntArray, points: Array, tracks: Tracks, frame: IntArray, poses: Array) -> Array:
    """Distance ``(k,)`` [m] of points from the pose that saw them first; NaN where it is unknown.

    Parameters
    ----------
    track, points : (k,), (k, 3)
    tracks : Tracks
    frame, poses : (T,), (T, 4, 4)
    """
    seen, first = np.unique(tracks.track, return_index=True)
    depth = np.full(len(track), np.nan)
    if not len(seen) or not len(frame):
        return depth
    place = np.minimum(np.searchsorted(seen, track), len(seen) - 1)
    begin = tracks.frame[first[place]]
    at = np.minimum(np.searchsorted(frame, begin), len(frame) - 1)
    known = (seen[place] == track) & (frame[at] == begin)
    depth[known] = np.linalg.norm(points[known] - poses[at[known], :3, 3], axis=1)
    return depth
