"""Everything that is known of a run, and of two: arrays, which metrics sum up and figures show."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.record import Record, Tracks
from vislam.core.run import Run
from vislam.evaluation import maps, normalised
from vislam.evaluation.agreement import Agreement, agreement
from vislam.evaluation.degenerate import degeneracies
from vislam.evaluation.held_out import HeldOut, HeldOutScore, Paired, paired, score
from vislam.evaluation.maps import Bin, MapDifference, MapErrors
from vislam.evaluation.normalised import Normalised
from vislam.evaluation.statistics import Statistic, Whiteness
from vislam.evaluation.trajectory_scores import TrajectoryScores, score_trajectory
from vislam.geometry import se3

DEPTHS = np.array([0.0, 10.0, 20.0, 40.0, 80.0, np.inf])
"""Bounds of the depths by which maps are compared [m]."""
VIEWS = np.array([1.0, 3.0, 6.0, 12.0, 24.0, np.inf])
"""Bounds of the numbers of views."""


@dataclass(frozen=True)
class RunScores:
    """What is known of one run.

    Attributes
    ----------
    run : Run
        Levelled: what is planar, or a height, is so against the vertical, where a run knows it.
    final, causal : TrajectoryScores or None
        Its poses as known in the end and at their own time; None without a reference.
    claims : dict of str to Normalised
        Errors beside what was claimed of them, by the name of the statistic.
    nis : Statistic or None
    whiteness : Whiteness or None
        Of the NIS.
    map : MapErrors or None
        Against true landmarks, with the first pose laid on the true one.
    map_aligned : MapErrors or None
        The same with the alignment of the whole trajectory.
    held_out : HeldOutScore or None
        By the tracks that no estimator was given.
    degenerate : tuple of str
        Why it is no answer to the data, and not to be ranked; empty for a sound run.
    """

    run: Run
    final: TrajectoryScores | None
    causal: TrajectoryScores | None
    claims: Mapping[str, Normalised]
    nis: Statistic | None
    whiteness: Whiteness | None
    map: MapErrors | None
    map_aligned: MapErrors | None
    held_out: HeldOutScore | None
    degenerate: tuple[str, ...] = ()

    @cached_property
    def statistics(self) -> dict[str, Statistic]:
        """Every statistic whose distribution is known if the run is consistent, by name."""
        found = {"nis": self.nis, "fit": fit_statistic(self.run)}
        own = {name: statistic for name, statistic in found.items() if statistic is not None}
        return {**own, **{name: claim.statistic() for name, claim in self.claims.items()}}


@dataclass(frozen=True)
class PairScores:
    """What is known of two runs together, with no reference involved.

    Attributes
    ----------
    agreement : Agreement or None
        Of their poses, as known in the end; None where one of them claims nothing.
    map : MapDifference or None
    depth, views : (k,)
        Depth [m] of each landmark of ``map`` from the pose that saw it first, and the number of its views.
    held_out : Paired or None
    """

    agreement: Agreement | None
    map: MapDifference | None
    depth: Array
    views: IntArray
    held_out: Paired | None

    def by_depth(self) -> list[Bin]:
        """How far the maps are apart, by the depth of the landmarks [m]."""
        return self._binned(self.depth, DEPTHS)

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


def score_run(run: Run, record: Record) -> RunScores:
    """Score one run."""
    run = run.levelled()
    reference, held = record.reference, record.held_out
    final = causal = None
    if reference is not None:
        final = causal = score_trajectory(run.frame, run.stamp, run.final.world_T_imu, reference)
        if run.smoothed is not None:
            causal = score_trajectory(run.frame, run.stamp, run.filtered.world_T_imu, reference)
    joined, aligned = _map_errors(run, record, final)
    return RunScores(
        run=run,
        final=final,
        causal=causal,
        claims={claim.name: claim for claim in _claims(run, record, final, joined)},
        nis=normalised.nis_statistic(run),
        whiteness=normalised.nis_whiteness(run),
        map=joined,
        map_aligned=aligned,
        held_out=(
            score(HeldOut(held.frame, held.track, held.z, record.rig), run.final.world_T_imu, frame=run.frame)
            if len(held.track)
            else None
        ),
        degenerate=degeneracies(run, record),
    )


def _claims(
    run: Run, record: Record, final: TrajectoryScores | None, joined: MapErrors | None
) -> list[Normalised]:
    """Errors of poses, biases and landmarks beside what the run claims of them."""
    reference, found = record.reference, list[Normalised | None]()
    if reference is None or final is None:
        return []
    for causal in (False,) if run.smoothed is None else (False, True):
        if reference.pose is not None:
            found += (normalised.pose_errors(run, reference, causal=causal) or {}).values()
        else:
            found.append(
                normalised.position_errors(
                    run, reference, planar=reference.planar, reference_sigma=reference.sigma, causal=causal
                )
            )
    if reference.bias is not None:
        found.append(normalised.bias_errors(run, reference.bias))
    if joined is not None:
        found.append(joined.normalised)
    return [claim for claim in found if claim is not None]


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


def score_pair(one: RunScores, other: RunScores, record: Record) -> PairScores:
    """Score two runs against each other."""
    apart = maps.map_difference(one.run, other.run)
    depth, views = np.empty(0), np.empty(0, np.int64)
    if apart is not None:
        mapped = one.run.landmarks
        own = np.searchsorted(mapped.track, apart.track, sorter=(order := np.argsort(mapped.track)))
        points = mapped.points_world[order[own]]
        depth = _depth(apart.track, points, record.given, one.run.frame, one.run.final.world_T_imu)
        views = np.bincount(record.given.track, minlength=int(apart.track.max()) + 1)[apart.track]
    better = None
    if one.held_out is not None and other.held_out is not None and len(one.held_out.track):
        better = paired(one.held_out, other.held_out)
    return PairScores(
        agreement=agreement(one.run, other.run),
        map=apart,
        depth=depth,
        views=views,
        held_out=better,
    )


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
