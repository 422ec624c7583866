"""Numbers out of scores: what ``metrics.json`` lists, each with its unit and what it was measured against."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.core.run import BESIDE, Estimate, Run
from vislam.evaluation import trajectory
from vislam.evaluation.alignment import align
from vislam.evaluation.clouds import CloudErrors
from vislam.evaluation.difference import ErrorDifference
from vislam.evaluation.maps import MapDifference
from vislam.evaluation.metric import LAG_METRICS, at_lag
from vislam.evaluation.normalised import MULTIPLES, Normalised
from vislam.evaluation.proper_scores import energy_score, log_score
from vislam.evaluation.scores import EstimatePair, EstimateScores, PairScores, RunScores
from vislam.evaluation.smoothing import TOLERANCE, SmoothingDifference
from vislam.evaluation.statistics import Statistic
from vislam.evaluation.trajectory_scores import WORST_LENGTH, TrajectoryScores, headline_alignment
from vislam.geometry import se3

_SPEED_KEYS = {"step_time_p50_ms": 50.0, "step_time_p95_ms": 95.0}
_MATCHING_UNITS = {"share_matched": "%", "completion": "%"}
_MATCHING_UNITS |= dict.fromkeys(("clock_offset", "clock_offset_low", "clock_offset_high"), "s")
_YAW = 2
_AS_A_PERSON = ("pose", "position", "position_planar", "position_aligned")
"""Parts of which consistency is stated by the scale of the sigmas and by a region, too."""
_FEWEST = 3
"""Common frames without which two trajectories are not compared."""


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
    convention : str
        Alignment, gauge and form of the error, where there is a choice.
    estimate : "filtered", "smoothed" or None
        Estimate of the trajectory that it is of; None: it is of the run as a whole.
    """

    estimator: str
    key: str
    value: float
    unit: str
    against: str = ""
    convention: str = ""
    estimate: Estimate | None = None


def of_run(scores: RunScores, reference: str, *, travelled: float = np.nan) -> Iterator[Metric]:
    """Metrics of one run.

    Parameters
    ----------
    scores : RunScores
    reference : str
        Name of what it was scored against.
    travelled : float
        Length of the path by the inertial data alone [m]; NaN where it is not known.
    """
    name = scores.run.name
    for estimate, found in scores.estimates.items():
        for key, value, unit, convention in _against(found):
            yield Metric(name, key, value, unit, reference, convention, estimate)
        for key, value, unit in (*_of_itself(scores.run, estimate), *_held_out(found)):
            yield Metric(name, key, value, unit, estimate=estimate)
        if found.fit is not None:
            yield Metric(name, "fit_per_dof", found.fit.value, "1", estimate=estimate)
    if scores.bias is not None:
        for key, value, unit, convention in _claim(scores.bias, scores.statistics[scores.bias.name]):
            yield Metric(name, key, value, unit, reference, convention)
    yield Metric(name, "path_length_inertial", travelled, "m", convention="speed by the inertial data alone")
    for key, value, unit in (*_cost(scores.run), *_innovations(scores), *_matching(scores)):
        yield Metric(name, key, value, unit)
    yield from _lags(scores, reference)
    for key, value, convention in _smoothing(scores.smoothing):
        yield Metric(name, key, value, "1", convention=convention)


def _lags(scores: RunScores, reference: str) -> Iterator[Metric]:
    """Metrics of the poses as known at each lag."""
    name = scores.run.name
    for lag in scores.lags:
        told = "from all data" if lag.frames is None else f"as known {lag.frames} frames later"
        for key, value in lag.values.items():
            spec = LAG_METRICS[key]
            against = "" if key == "held_out_median" else reference
            yield Metric(name, at_lag(key, lag.label), value, spec.unit or "1", against, f"poses {told}")
    if scores.lags:
        yield Metric(name, "frame_period_s", float(np.median(np.diff(scores.run.stamp))), "s")


def _smoothing(found: SmoothingDifference | None) -> Iterator[tuple[str, float, str]]:
    """Filtered poses against smoothed ones, by the difference of the covariances."""
    if found is None:
        return
    frames = len(found.frame) + found.indefinite + found.untested
    told = f"share of {frames} frames at which P_filtered - P_smoothed is not positive semi-definite"
    yield (
        "smoothing_indefinite",
        found.indefinite / frames,
        f"{told}, by more than {TOLERANCE:g} of P_filtered",
    )
    statistic = found.statistic()
    if statistic is not None:
        yield "smoothing_per_dof", statistic.value, statistic.convention


def _against(scores: EstimateScores) -> Iterator[tuple[str, float, str, str]]:
    """Metrics of an estimate against the reference."""
    if scores.trajectory is not None:
        yield from _headline(scores.trajectory)
        yield from _trajectory(scores.trajectory)
    yield from _map(scores)
    for name, claim in scores.claims.items():
        yield from _claim(claim, scores.statistics[name])
    if scores.efficiency is not None:
        yield from scores.efficiency.metrics()


def _headline(scores: TrajectoryScores) -> Iterator[tuple[str, float, str, str]]:
    """Errors that speak for a whole trajectory."""
    yield "ate_planar_rmse", scores.absolute["planar"].position.rmse, "m", "alignment planar"
    if not scores.matched.planar:
        yield "ate_rmse", scores.absolute["se3"].position.rmse, "m", "alignment se3"
    if scores.kitti is not None:
        yield "kitti_t_rel", scores.kitti.t_rel, "%", "KITTI odometry kit, 100 to 800 m"
        yield "kitti_r_rel", scores.kitti.r_rel, "deg/100m", "KITTI odometry kit, 100 to 800 m"


def _trajectory(scores: TrajectoryScores) -> Iterator[tuple[str, float, str, str]]:
    """All other errors of a trajectory."""
    yield from _absolute(scores)
    yield from _relative(scores)
    if scores.kitti is not None:
        for length, drift in scores.kitti.by_length().items():
            yield f"kitti_t_rel_{length}m", drift.t_rel, "%", "KITTI odometry kit"
            yield f"kitti_r_rel_{length}m", drift.r_rel, "deg/100m", "KITTI odometry kit"
    if scores.final_drift is not None:
        yield "drift_end", scores.final_drift, "%", "alignment first_pose, of the distance travelled"
    yield "frames_without_reference", float(scores.matched.estimate_dropped), "1", ""
    yield "reference_without_frame", float(scores.matched.reference_dropped), "1", ""


def _absolute(scores: TrajectoryScores) -> Iterator[tuple[str, float, str, str]]:
    main = headline_alignment(scores.matched.planar)
    for kind, errors in scores.absolute.items():
        told = f"alignment {kind}"
        if kind not in ("se3", "planar"):
            yield f"ate_{kind}_rmse", errors.position.rmse, "m", told
        if kind == main:
            position = errors.position
            for key, value in (("mean", position.mean), ("median", position.median), ("max", position.max)):
                yield f"ate_{key}", value, "m", told
        if errors.rotation is not None and kind in (main, "first_pose"):
            key = "ate_rotation_rmse" if kind == main else f"ate_rotation_{kind}_rmse"
            yield key, float(np.rad2deg(errors.rotation.rmse)), "deg", told


def _relative(scores: TrajectoryScores) -> Iterator[tuple[str, float, str, str]]:
    kind, told = "rpe", ""
    if scores.matched.pose is None:
        kind, told = "displacement", "in the plane, alignment planar"
    by = [(f"{length:g}m", errors) for length, errors in scores.by_distance.items()]
    by += [(f"{duration:g}s", errors) for duration, errors in scores.by_time.items()]
    for text, errors in by:
        if errors.translation is not None:
            yield f"{kind}_{text}_rmse", errors.translation.rmse, "m", told
        if errors.rotation is not None:
            yield f"{kind}_{text}_rotation_rmse", float(np.rad2deg(errors.rotation.rmse)), "deg", told
    if scores.worst:
        told = f"the worst {WORST_LENGTH:g} m, from frame {scores.worst[0].first} to {scores.worst[0].last}"
        yield f"{kind}_worst_{WORST_LENGTH:g}m", scores.worst[0].error, "m", told


def _map(scores: EstimateScores) -> Iterator[tuple[str, float, str, str]]:
    for key, found, told in (
        ("map_error", scores.map, "alignment first_pose"),
        ("map_error_aligned", scores.map_aligned, "alignment se3"),
    ):
        if found is not None:
            yield f"{key}_median", float(np.median(found.distance)), "m", told
            yield f"{key}_rmse", float(np.sqrt(np.mean(found.distance**2))), "m", told
    if scores.map is not None:
        told = "of the true landmarks of the tracks that were given"
        yield "map_completeness", scores.map.estimated, "1", told
        yield "map_found", scores.map.found, "1", f"{told}, within 5 % of the depth"


def _claim(claim: Normalised, statistic: Statistic) -> Iterator[tuple[str, float, str, str]]:
    """Average of normalised errors, and shares of errors within multiples of what was claimed."""
    yield claim.name, statistic.value, "1", claim.convention
    shares = claim.within().mean(axis=1)
    for multiple, share in zip(MULTIPLES, shares, strict=True):
        key = f"coverage_{claim.name.removeprefix('nees_')}_{multiple:g}sigma"
        yield key, float(share), "1", "mean over the components"
    part = claim.name.removeprefix("nees_")
    if _of_own(part) in _AS_A_PERSON:
        yield (
            f"scale_gap_{part}",
            claim.scale_gap(),
            "1",
            "errors over sigmas, an axis, by the medians",
        )
        told = "share of the frames whose error lies within the estimated 90 % region"
        yield f"coverage_90_{part}", float(claim.coverage_curve(np.array([0.9]))[0]), "1", told
    if claim.factor is not None:
        part = claim.name.removeprefix("nees_")
        told = f"proper score, less is better; {claim.convention}"
        score = float(log_score(claim.whitened, claim.factor).mean())
        yield f"log_score_{part}", score, "nats", told
        if part.startswith("position"):
            yield f"energy_score_{part}", float(energy_score(claim.whitened, claim.factor).mean()), "m", told


def _of_own(part: str) -> str:
    """Part of a pose without the kind of its covariances."""
    for kind in BESIDE:
        part = part.removesuffix(f"_{kind}")
    return part


def _of_itself(run: Run, estimate: Estimate) -> Iterator[tuple[str, float, str]]:
    poses = run.poses(estimate).world_T_imu
    yield "path_length", trajectory.path_length(poses), "m"
    yield "height_end", float(poses[-1, 2, 3]), "m"
    if len(run.cost.step_time):
        # Before the end no time has gone into the final estimate.
        steps_only = estimate != run.estimates[-1]
        yield "total_time_s", float(run.cost.step_time.sum()) if steps_only else run.cost.total_time, "s"


def _cost(run: Run) -> Iterator[tuple[str, float, str]]:
    yield "frames", float(len(run.stamp)), "1"
    if not len(run.cost.step_time):
        # From elsewhere: nobody knows how it was made.
        return
    for key, percentile in _SPEED_KEYS.items():
        yield key, float(1e3 * np.percentile(run.cost.step_time, percentile)), "ms"
    yield "peak_rss_mb", run.cost.peak_rss / 1e6, "MB"
    yield "landmarks", float(len(run.landmarks)), "1"
    yield "observations_used", float(run.used.sum()), "1"
    yield "observations_gated", float(run.gated.sum()), "1"


def _matching(scores: RunScores) -> Iterator[tuple[str, float, str]]:
    """How one from elsewhere was matched with the reference."""
    if scores.own is not None:
        for key, value in scores.own.facts.items():
            yield key, value, _MATCHING_UNITS.get(key, "1")
    if scores.cloud is not None:
        yield from _cloud(scores.cloud)


def _cloud(found: CloudErrors) -> Iterator[tuple[str, float, str]]:
    """How far a map of points without identities is from another."""
    if len(found.near):
        yield "map_error_nearest_median", float(np.median(found.near)), "m"
        yield "map_error_nearest_rmse", float(np.sqrt(np.mean(found.near**2))), "m"
    yield "map_points_within", 100.0 * found.within, "%"
    yield "map_points_complete", 100.0 * found.complete, "%"
    for row in found.by_depth():
        if row.count:
            yield f"map_error_nearest_median_from_{row.low:g}_baselines", row.distance, "m"


def _innovations(scores: RunScores) -> Iterator[tuple[str, float, str]]:
    if scores.nis is not None:
        yield "nis_per_dof", scores.nis.value, "1"
    if scores.whiteness is not None:
        yield "nis_autocorrelation", float(scores.whiteness.autocorrelation[0]), "1"
        yield "nis_white_p", scores.whiteness.p_value, "1"
    gained = scores.run.innovations.spurious_information
    if np.isfinite(gained).all() and len(gained):
        yield "spurious_yaw_information", float(gained[:, _YAW].sum()), "1/rad^2"
        yield "spurious_position_information", float(gained[:, 3:].sum(axis=0).mean()), "1/m^2"


def _held_out(scores: EstimateScores) -> Iterator[tuple[str, float, str]]:
    if scores.held_out is not None and len(scores.held_out.track):
        yield "held_out_median", scores.held_out.median, "px"
        yield "held_out_rms", scores.held_out.capped_rms, "px"
        yield "tracks_held_out_capped", float(scores.held_out.capped), "1"


def of_pair(one: RunScores, other: RunScores, scores: PairScores) -> Iterator[Metric]:
    """Metrics of two runs against each other."""
    pair = f"{one.run.name}|{other.run.name}"
    for estimate, found in scores.estimates.items():
        for key, value, unit in _apart(one.run, other.run, estimate):
            yield Metric(pair, key, value, unit, estimate=estimate)
        for key, value, convention in _agreement(found):
            yield Metric(pair, key, value, "1", convention=convention, estimate=estimate)
        for key, value, unit in _errors_apart(found.error):
            told = "ATE of the first less that of the second, 95 % interval by blocks of the path"
            yield Metric(pair, key, value, unit, convention=told, estimate=estimate)
    for key, value, convention in _smoothing(scores.smoothing):
        yield Metric(pair, key, value, "1", convention=convention)
    if scores.by_sum is not None:
        told = "filtered against smoothed; worlds joined at the first pose, by the sum of the two covariances"
        yield Metric(pair, "smoothing_by_sum", scores.by_sum.per_freedom, "1", convention=told)
    if scores.cloud is not None:
        told = "each point with the nearest of the other map, worlds aligned by the poses"
        for key, value, unit in _cloud(scores.cloud):
            yield Metric(pair, key, value, unit, convention=told)
    ends = one.run.estimates[-1], other.run.estimates[-1]
    told = f"landmarks of the {ends[0]} estimate of the first and of the {ends[1]} one of the second"
    both = ends[0] if ends[0] == ends[1] else None
    for key, value, unit, convention in _maps_apart(one.run, other.run, scores.map):
        yield Metric(pair, key, value, unit, convention=f"{told}; {convention}", estimate=both)


def _errors_apart(found: ErrorDifference | None) -> Iterator[tuple[str, float, str]]:
    """How far the errors of two runs are apart."""
    if found is not None:
        yield "difference_ate", found.value, "m"
        yield "difference_ate_low", found.low, "m"
        yield "difference_ate_high", found.high, "m"
        yield "difference_ate_blocks", found.blocks, "1"


def _apart(one: Run, other: Run, estimate: Estimate) -> Iterator[tuple[str, float, str]]:
    """How far the poses of two runs are apart: by nothing but their common start, and aligned."""
    positions, others = _positions(one, other, (estimate, estimate))
    if len(positions) < _FEWEST:
        return
    yield "trajectory_distance_rmse", _rms(positions - others), "m"
    rotation, translation = align(others, positions)
    yield "trajectory_distance_aligned_rmse", _rms(positions - (others @ rotation.T + translation)), "m"


def _positions(one: Run, other: Run, estimates: tuple[Estimate, Estimate]) -> tuple[Array, Array]:
    """Positions ``(n, 3)`` [m] of an estimate of each of two runs, of the frames that both have."""
    _, first, second = np.intersect1d(one.frame, other.frame, return_indices=True)
    poses = one.poses(estimates[0]).world_T_imu, other.poses(estimates[1]).world_T_imu
    return poses[0][first, :3, 3], poses[1][second, :3, 3]


def _maps_apart(
    one: Run, other: Run, difference: MapDifference | None
) -> Iterator[tuple[str, float, str, str]]:
    """How far two maps are apart."""
    positions, others = _positions(one, other, (one.estimates[-1], other.estimates[-1]))
    common, first, second = np.intersect1d(one.landmarks.track, other.landmarks.track, return_indices=True)
    if len(positions) >= _FEWEST and len(common):
        rotation, translation = align(others, positions)
        pose = se3.from_rotation_translation(rotation, translation)
        gap = one.landmarks.points_world[first] - se3.transform(pose, other.landmarks.points_world[second])
        yield "landmarks_common", float(len(common)), "1", "by their tracks"
        distance = float(np.median(np.linalg.norm(gap, axis=1)))
        yield "map_distance_median", distance, "m", "worlds aligned by the poses"
    if difference is not None and np.isfinite(difference.squared).any():
        known = difference.squared[np.isfinite(difference.squared)]
        by = "worlds joined at the first pose"
        yield "landmark_distance_per_freedom", float(known.mean()) / 3.0, "1", by


def _agreement(scores: EstimatePair) -> Iterator[tuple[str, float, str]]:
    """Agreement within the estimated covariances, and which run predicts the held-out tracks better."""
    if scores.agreement is not None:
        found, by = scores.agreement, "worlds joined at the first pose, by the sum of the two covariances"
        yield "distance_per_freedom", found.per_freedom, by
        yield "poses_beyond_95", found.share_beyond(), by
        frame, certainty = found.divergence(), found.certainty()
        if frame is not None:
            yield "divergence_frame", float(frame), f"{by}; beyond the 99 % bound of all frames together"
        yield from _agreement_considered(scores)
        told = "estimated variance of the first over that of the second, median over the frames"
        yield "variance_ratio", certainty.overall, f"{told}; geometric mean of all directions"
        yield "variance_ratio_smallest", certainty.smallest, f"{told}; mostly in {certainty.smallest_along}"
        yield "variance_ratio_largest", certainty.largest, f"{told}; mostly in {certainty.largest_along}"
    if scores.held_out is not None:
        told = "share of the held-out tracks that the first predicts better"
        yield "held_out_better", scores.held_out.better, told
        yield "held_out_better_low", scores.held_out.low, f"{told}, 95 % interval"
        yield "held_out_better_high", scores.held_out.high, f"{told}, 95 % interval"
        yield "held_out_p", scores.held_out.p_value, f"{told}: chance of as much if neither were better"


def _agreement_considered(scores: EstimatePair) -> Iterator[tuple[str, float, str]]:
    """How far apart two runs are where the errors are considered that they share."""
    found = scores.agreement_considered
    if found is not None:
        by = "worlds joined at the first pose, by the two covariances and the difference of the changes"
        yield "distance_per_freedom_considered", found.per_freedom, by
        yield "poses_beyond_95_considered", found.share_beyond(), by


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
