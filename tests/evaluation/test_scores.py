"""What is known of a run and of two, and the metrics that sum it up, on runs of a short simulated drive."""

import json
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from tests.records import on_frames
from vislam.cli.console import Terminal
from vislam.comparison.compare import compare
from vislam.comparison.config import Config
from vislam.comparison.results import Results, metrics_document
from vislam.core.reference import Reference
from vislam.evaluation import evaluate


@pytest.fixture(scope="module")
def results(short_config: Config, tmp_path_factory) -> Results:
    sections = {
        "dead_reckoning": {},
        "eks": {"observability": True},
        "isam2": {"marginals": "all", "pose_cov_every": 1},
    }
    config = replace(short_config, seed=3, estimators=sections)
    terminal, out = Terminal(), tmp_path_factory.mktemp("scores")
    return compare(
        config, out=out, data_dir=None, allow_substitute=True, progress=terminal, report=False
    ).results


@pytest.fixture(scope="module")
def evaluation(results):
    return evaluate(results.runs, results.record)


def with_reference(results, reference):
    return evaluate(results.runs, replace(results.record, reference=reference))


def keys(evaluation, name):
    return {metric.key for metric in evaluation.metrics if metric.estimator == name}


def test_every_metric_stands_once_and_is_a_number(results, evaluation):
    assert max(Counter((m.estimator, m.key, m.estimate) for m in evaluation.metrics).values()) == 1
    assert all(metric.unit for metric in evaluation.metrics)
    # Nothing in the document is beyond JSON, which knows no NaN.
    json.dumps(metrics_document(results, evaluation, (), ()), allow_nan=False)


def test_metrics_are_those_of_the_scores(results, evaluation):
    for name, run in results.runs.items():
        scores = evaluation.scores[name].final
        absolute = scores.trajectory.absolute["se3"]
        assert evaluation.value(name, "ate_rmse") == absolute.position.rmse
        assert evaluation.value(name, "ate_rmse") <= evaluation.value(name, "ate_yaw_position_rmse")
        assert evaluation.value(name, "ate_sim3_rmse") <= evaluation.value(name, "ate_rmse")
        assert evaluation.value(name, "held_out_median") == scores.held_out.median
        assert evaluation.value(name, "frames") == len(run.stamp)
    assert (
        evaluation.value("isam2", "fit_per_dof")
        == results.runs["isam2"].fit[0] / results.runs["isam2"].fit[1]
    )
    assert evaluation.value("eks", "nees_pose") == evaluation.statistic("eks", "nees_pose").value


def test_who_claims_nothing_is_asked_nothing(evaluation):
    alone = keys(evaluation, "dead_reckoning")
    assert not any(key.startswith(("map_", "nis_", "nees_landmark", "fit_")) for key in alone)
    assert "fit_per_dof" not in keys(evaluation, "eks")
    assert "nis_per_dof" not in keys(evaluation, "isam2")
    assert "spurious_yaw_information" in keys(evaluation, "eks")
    assert "spurious_yaw_information" not in keys(evaluation, "isam2")


def test_a_consistent_filter_gains_nothing_of_where_the_world_is(evaluation):
    assert evaluation.value("eks", "spurious_yaw_information") < 1e-3


def test_every_claim_has_its_coverage_and_says_its_convention(evaluation):
    for name in ("eks", "isam2"):
        for part in ("pose", "rotation", "position", "landmark"):
            shares = [evaluation.value(name, f"coverage_{part}_{k}sigma") for k in (1, 2, 3)]
            assert shares == sorted(shares)
            assert 0.0 <= shares[0] <= shares[2] <= 1.0
        metric = evaluation.metric(name, "nees_pose")
        assert "right perturbation" in metric.convention
        assert metric.against == "truth"


def test_landmarks_have_the_depth_and_the_views_that_their_tracks_have(results, evaluation):
    pair, given = evaluation.pairs["eks", "isam2"], results.record.given
    run = evaluation.scores["eks"].run
    for index in range(0, len(pair.map.track), 7):
        track = pair.map.track[index]
        rows = np.flatnonzero(given.track == track)
        assert pair.views[index] == len(rows)
        point = run.landmarks.points_world[run.landmarks.track == track][0]
        start = run.final.world_T_imu[given.frame[rows[0]], :3, 3]
        assert pair.depth[index] == pytest.approx(np.linalg.norm(point - start))
    assert sum(row.count for row in pair.by_depth()) == len(pair.map.track)
    assert sum(row.count for row in pair.by_views()) == len(pair.map.track)


def test_a_map_is_complete_without_the_landmarks_that_nobody_was_given(results, evaluation):
    given = np.unique(results.record.given.track)
    for name in ("eks", "isam2"):
        known = np.isin(given, results.runs[name].landmarks.track).mean()
        assert evaluation.value(name, "map_completeness") == pytest.approx(known)
    assert evaluation.value("eks", "map_completeness") > 0.95


def test_nobody_was_given_the_held_out_tracks(results):
    record = results.record
    assert len(record.held_out.track)
    assert not np.isin(record.given.track, record.held_out.track).any()
    for run in results.runs.values():
        assert not np.isin(run.landmarks.track, record.held_out.track).any()
    assert record.counts["held_out_tracks"] == len(np.unique(record.held_out.track))


def planar(reference, **values):
    return Reference(
        name="poles",
        limits="planar",
        frame=reference.frame[::2],
        position=reference.position[::2, :2],
        pose=None,
        imu_T_point=np.eye(4),
        **values,
    )


def test_a_planar_reference_allows_what_a_plane_allows(results):
    found = with_reference(results, planar(results.record.reference, sigma=0.02))
    names = keys(found, "isam2")
    assert {"ate_planar_rmse", "displacement_5m_rmse", "nees_position_planar", "ate_none_rmse"} <= names
    assert not any(
        key.startswith(("rpe_", "kitti_", "nees_pose", "ate_rotation", "map_error")) for key in names
    )
    assert "ate_rmse" not in names
    assert found.value("isam2", "frames_without_reference") == 12


def test_without_a_reference_there_is_still_much_to_say(results, evaluation):
    found = with_reference(results, None)
    assert not any(metric.against for metric in found.metrics)
    assert found.value("isam2", "held_out_median") == evaluation.value("isam2", "held_out_median")
    key = "distance_per_freedom"
    assert found.value("eks|isam2", key) == evaluation.value("eks|isam2", key)


def test_a_run_with_gaps_is_compared_on_the_frames_that_it_has(results, evaluation):
    whole, rows = results.runs["isam2"], np.arange(0, 25, 3)
    some = replace(on_frames(whole, rows), name="some")
    found = evaluate({**results.runs, "some": some}, results.record)
    claims, all_claims = found.scores["some"].final.claims, evaluation.scores["isam2"].final.claims
    shared = np.isin(all_claims["nees_pose"].index, claims["nees_pose"].index)
    assert np.array_equal(claims["nees_pose"].index, rows[1:])
    assert np.allclose(claims["nees_pose"].nees, all_claims["nees_pose"].nees[shared])
    apart = found.pairs["isam2", "some"].estimates["smoothed"].agreement
    assert np.array_equal(apart.frame, rows[1:])
    assert np.allclose(apart.squared, 0.0, atol=1e-9)
    # Tracks with a view in a frame that it lacks count as lost.
    assert found.value("some", "tracks_held_out_capped") > 0


FINAL_ONLY = ("map_error", "map_completeness", "map_found", "nees_landmark", "coverage_landmark", "fit_")
"""How keys start of what belongs to the landmarks and residuals in the end."""


@pytest.mark.parametrize("name", ["eks", "isam2"])
def test_filtered_scores_are_those_of_a_run_that_has_filtered_poses_alone(results, evaluation, name):
    run = replace(results.runs[name], smoothed=None)
    alone = evaluate({name: run}, results.record)
    own = {m.key: m.value for m in evaluation.metrics if (m.estimator, m.estimate) == (name, "filtered")}
    assert {"ate_rmse", "rpe_5m_rmse", "drift_end", "held_out_median", "nees_pose", "height_end"} <= set(own)
    # What the steps took is less than what they and the smoothing took.
    assert 0.0 < own.pop("total_time_s") < evaluation.value(name, "total_time_s", "smoothed")
    for key, value in own.items():
        assert alone.value(name, key) == value, key
    other = {m.key for m in alone.metrics if (m.estimator, m.estimate) == (name, "filtered")} - set(own)
    assert all(key.startswith(FINAL_ONLY) or key == "total_time_s" for key in other)


@pytest.mark.parametrize("name", ["eks", "isam2"])
def test_every_score_of_the_poses_is_there_of_both_estimates(evaluation, name):
    of = {
        estimate: {m.key for m in evaluation.metrics if (m.estimator, m.estimate) == (name, estimate)}
        for estimate in ("filtered", "smoothed", None)
    }
    assert of["filtered"] <= of["smoothed"]
    assert all(key.startswith(FINAL_ONLY) for key in of["smoothed"] - of["filtered"])
    # Of the run as a whole: its time, its counts, and how the observations met its predictions.
    assert not of[None] & (of["filtered"] | of["smoothed"])
    assert {"step_time_p50_ms", "peak_rss_mb", "observations_used", "frames"} <= of[None]
    assert evaluation.value(name, "ate_rmse") == evaluation.value(name, "ate_rmse", "smoothed")
    assert evaluation.value(name, "ate_rmse", "filtered") > evaluation.value(name, "ate_rmse", "smoothed")
    assert evaluation.statistic(name, "nees_pose") is evaluation.statistic(name, "nees_pose", "smoothed")


def test_two_runs_are_held_against_each_other_by_the_same_estimate_only(evaluation):
    assert tuple(evaluation.pairs["eks", "isam2"].estimates) == ("filtered", "smoothed")
    mixed = evaluation.pairs["dead_reckoning", "eks"]
    assert tuple(mixed.estimates) == ("filtered",)
    pair = "dead_reckoning|eks"
    assert {m.estimate for m in evaluation.metrics if m.estimator == pair} == {"filtered"}
    assert evaluation.value(pair, "trajectory_distance_rmse", "smoothed") is None
    apart = evaluation.value("eks|isam2", "trajectory_distance_rmse", "filtered")
    assert apart != evaluation.value("eks|isam2", "trajectory_distance_rmse")
    found = evaluation.pairs["eks", "isam2"].estimates["filtered"].agreement
    assert found.estimates == ("filtered", "filtered")


def test_a_final_estimate_without_covariances_is_not_lent_those_of_the_filtered_one(results):
    run = results.runs["isam2"]
    bare = replace(run, smoothed=replace(run.smoothed, cov=None))
    found = evaluate({"isam2": bare}, results.record)
    assert found.value("isam2", "nees_pose", "filtered") is not None
    assert found.value("isam2", "nees_pose") is None
    assert found.statistic("isam2", "nees_pose") is None
