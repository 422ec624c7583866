"""Metrics on trajectories whose errors are known."""

import json

import numpy as np
import pytest

from tests.records import made_record
from vislam.data.reference import Reference, truth_reference
from vislam.evaluation import evaluate
from vislam.evaluation.alignment import align
from vislam.evaluation.trajectory import kitti_drift, match, path_length
from vislam.geometry import se3
from vislam.run import Run


def circle(frames=400, radius=50.0):
    angle = np.linspace(0.0, 2.0 * np.pi, frames)
    xi = np.zeros((frames, 6))
    xi[:, 2] = angle
    pose = se3.exp(xi)
    pose[:, :3, 3] = radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle), 0.1 * angle])
    return pose


def made_run(name, pose, **values):
    frames = len(pose)
    plain = {
        "name": name,
        "error": "",
        "frames_expected": frames,
        "frame": np.arange(frames),
        "stamp": 0.1 * np.arange(frames),
        "world_T_imu": pose,
        "world_T_imu_causal": pose,
        "pose_cov": np.full((frames, 6, 6), np.nan),
        "pose_cov_causal": np.full((frames, 6, 6), np.nan),
        "bias": np.zeros((frames, 6)),
        "bias_sigma": np.zeros((frames, 6)),
        "nis": np.zeros(frames),
        "dof": np.zeros(frames, np.int64),
        "log_likelihood": np.zeros(frames),
        "world_gained": np.full((frames, 6), np.nan),
        "step_time": np.full(frames, 0.002),
        "total_time": 1.0,
        "peak_rss": 10**8,
        "used": np.ones(5, bool),
        "gated": np.zeros(5, bool),
        "track": np.arange(3),
        "points_world": np.eye(3),
        "points_cov": None,
        "counts": {},
    }
    return Run(**{**plain, **values})


def of_truth(pose):
    return truth_reference(pose, np.arange(3), np.eye(3))


@pytest.mark.parametrize("dimensions", [2, 3])
def test_alignment_undoes_a_rigid_motion(rng, dimensions):
    points = rng.normal(size=(30, dimensions))
    rotation = np.linalg.qr(rng.normal(size=(dimensions, dimensions)))[0]
    rotation[:, 0] *= np.sign(np.linalg.det(rotation))
    found, shift = align(points, points @ rotation.T + 3.0)
    assert np.allclose(found, rotation)
    assert np.allclose(shift, 3.0)


def test_alignment_never_mirrors(rng):
    points = rng.normal(size=(30, 2))
    rotation, _ = align(points, points * [1.0, -1.0])
    assert np.linalg.det(rotation) > 0.999


def test_a_moved_trajectory_has_no_error_and_a_noisy_one_its_noise(rng):
    truth = circle()
    moved = se3.exp(rng.normal(size=6)) @ truth
    assert match(moved, of_truth(truth), planar=False).ate < 1e-9
    noisy = truth.copy()
    noisy[:, :3, 3] += 0.3 * rng.normal(size=(400, 3))
    assert match(noisy, of_truth(truth), planar=False).ate == pytest.approx(0.3 * np.sqrt(3), rel=0.1)


def test_kitti_drift_of_a_scaled_straight_line():
    truth = np.tile(np.eye(4), (1000, 1, 1))
    truth[:, 0, 3] = np.arange(1000.0)
    scaled = truth.copy()
    scaled[:, 0, 3] *= 1.02
    t_rel, r_rel = kitti_drift(scaled, truth)
    # A segment ends at the first frame beyond its length, one frame late at the most.
    assert t_rel == pytest.approx(2.0, rel=0.02)
    assert r_rel == pytest.approx(0.0, abs=1e-9)
    assert kitti_drift(scaled[:50], truth[:50]) is None


def test_kitti_drift_of_a_steady_turn():
    truth = np.tile(np.eye(4), (500, 1, 1))
    truth[:, 0, 3] = np.arange(500.0)
    turning = np.zeros((500, 6))
    turning[:, 2] = np.deg2rad(0.01) * np.arange(500)
    bent = truth.copy()
    bent[:, :3, :3] = se3.exp(turning)[:, :3, :3]
    assert kitti_drift(bent, truth)[1] == pytest.approx(1.0, rel=0.02)


def test_metrics_of_two_runs_and_a_planar_reference():
    truth = circle()
    shifted = truth.copy()
    shifted[:, 0, 3] += 2.0
    reference = Reference("poles", "planar", np.arange(0, 400, 7), truth[::7, :2, 3], None, np.eye(4))
    runs = {
        "a": made_run("a", truth, nis=np.full(400, 6.0), dof=np.full(400, 3, np.int64)),
        "b": made_run("b", shifted, points_world=np.eye(3) + np.array([2.0, 0.0, 0.0])),
    }
    found = evaluate(runs, made_record(reference))
    assert found.value("a", "ate_planar_rmse") < 1e-9
    assert found.value("b", "ate_planar_rmse") < 1e-9
    assert found.value("a", "ate_rmse") is None
    assert found.value("a", "nis_per_dof") == pytest.approx(2.0)
    assert found.value("b", "nis_per_dof") is None
    assert found.value("a|b", "trajectory_distance_rmse") == pytest.approx(2.0)
    assert found.value("a|b", "trajectory_distance_aligned_rmse") < 1e-9
    assert found.value("a|b", "map_distance_median") < 1e-9
    assert found.value("a", "path_length") == pytest.approx(path_length(truth))
    json.dumps(found.records())


def test_an_incomplete_run_is_scored_on_what_it_finished():
    truth = circle()
    run = made_run("half", truth[:200], error="frame 200: lost", frames_expected=400)
    assert evaluate({"half": run}, made_record(of_truth(truth))).value("half", "ate_rmse") < 1e-9


def test_a_run_survives_its_file(tmp_path):
    run = made_run(
        "a", circle(20), points_cov=np.zeros((3, 3, 3)), counts={"late": 2}, events=("frame 3: one", "two")
    )
    run.save(tmp_path / "runs" / "a.npz")
    back = Run.load(tmp_path / "runs" / "a.npz")
    assert back.counts == run.counts
    assert back.events == run.events
    assert back.complete
    assert np.array_equal(back.world_T_imu, run.world_T_imu)
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["a.npz"]


def test_landmarks_are_scored_against_the_truth_from_the_first_pose(rng):
    truth, motion = circle(), se3.exp(rng.normal(size=6))
    off = np.array([[0.0, 0.0, 0.3], [0.0, 0.1, 0.0], [0.2, 0.0, 0.0]])
    run = made_run("a", motion @ truth, points_world=se3.transform(motion, np.eye(3) + off))
    assert evaluate({"a": run}, made_record(of_truth(truth))).value("a", "map_error_median") == pytest.approx(
        0.2
    )
