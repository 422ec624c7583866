"""Metrics on trajectories whose errors are known."""

import json

import numpy as np
import pytest

from tests.records import altered, made_record
from vislam.core.record import Tracks
from vislam.core.reference import Reference, truth_reference
from vislam.core.run import Cost, Innovations, Run, StateHistory
from vislam.core.step import TWIST_BIAS
from vislam.core.trajectory import Landmarks, Poses
from vislam.evaluation import evaluate
from vislam.evaluation.trajectory import path_length
from vislam.geometry import se3


def circle(frames=400, radius=50.0):
    angle = np.linspace(0.0, 2.0 * np.pi, frames)
    xi = np.zeros((frames, 6))
    xi[:, 2] = angle
    pose = se3.exp(xi)
    pose[:, :3, 3] = radius * np.column_stack([np.sin(angle), 1.0 - np.cos(angle), 0.1 * angle])
    return pose


def made_run(name, pose, *, filtered=None, **values):
    """Run with these final poses; other fields by their names, whichever part they are in."""
    frames = len(pose)
    run = Run(
        name=name,
        frames_expected=frames,
        frame=np.arange(frames),
        stamp=0.1 * np.arange(frames),
        filtered=Poses(pose) if filtered is None else filtered,
        smoothed=None if filtered is None else Poses(pose),
        states={TWIST_BIAS: StateHistory(np.zeros((frames, 6)), np.zeros((frames, 6)))},
        innovations=Innovations.unknown(frames),
        cost=Cost(np.full(frames, 0.002), 1.0, 10**8),
        used=np.ones(5, bool),
        gated=np.zeros(5, bool),
        map=Landmarks(np.arange(3), np.eye(3)),
    )
    return altered(run, **values)


def of_truth(pose):
    return truth_reference(pose, np.arange(3), np.eye(3))


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
    assert back.complete
    assert back.log == run.log
    assert back.smoothed is None
    assert np.array_equal(back.final.world_T_imu, run.final.world_T_imu)
    assert np.array_equal(back.states[TWIST_BIAS].value, run.states[TWIST_BIAS].value)
    assert np.array_equal(back.landmarks.points_cov, run.landmarks.points_cov)
    assert back.filtered.cov is None
    assert [path.name for path in (tmp_path / "runs").iterdir()] == ["a.npz"]


def test_landmarks_are_scored_against_the_truth_from_the_first_pose(rng):
    truth, motion = circle(), se3.exp(rng.normal(size=6))
    off = np.array([[0.0, 0.0, 0.3], [0.0, 0.1, 0.0], [0.2, 0.0, 0.0]])
    run = made_run("a", motion @ truth, points_world=se3.transform(motion, np.eye(3) + off))
    given = Tracks(np.zeros(3, np.int64), np.arange(3), np.zeros((3, 3)), np.ones((3, 3)))
    found = evaluate({"a": run}, made_record(of_truth(truth), given=given))
    assert found.value("a", "map_error_median") == pytest.approx(0.2)
    assert found.value("a", "map_completeness") == 1.0
