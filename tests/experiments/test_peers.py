"""Other programs beside ours: the same factors, the same files, and figures that are marked."""

import json
import zipfile

import gtsam
import numpy as np
import pytest

from experiments.peers import evo, graphs
from experiments.peers.__main__ import cpu, published_lines
from experiments.timing import CONFIGS, Drive
from vislam import compare
from vislam.estimators.smoother import SmootherOptions
from vislam.estimators.smoother.family import VARIANTS


@pytest.fixture(scope="module")
def drive():
    return Drive.open(CONFIGS / "tiny.yaml").first(12)


@pytest.fixture(scope="module")
def usable(drive):
    return np.ones(drive.sequence.observations, bool)


@pytest.fixture(scope="module")
def lagged(drive, usable):
    options = SmootherOptions(**{**VARIANTS["fixed_lag"], "lag_s": 0.5})
    return graphs.run_ours(drive, options, usable)


def test_what_ours_is_given_is_kept_frame_by_frame(drive, lagged):
    assert len(lagged.given) == len(lagged.poses) == len(drive.sequence)
    assert all(one.graph.size() and set(one.values.keys()) <= set(one.stamps) for one in lagged.given)
    assert min(lagged.steps_s, lagged.end_s) > 0.0


def test_the_same_solver_with_our_parameters_finds_the_same(lagged):
    parameters = gtsam.ISAM2Params()
    parameters.enableRelinearization = False
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.0))
    found = graphs.window(gtsam.IncrementalFixedLagSmoother(0.5, parameters), lagged.given)
    assert found.error == ""
    assert np.abs(found.poses - lagged.poses).max() < 1e-6


def test_a_solver_that_breaks_off_says_where_and_why(lagged):
    class Breaks:
        def update(self, *given):
            raise RuntimeError("\n no more\nrest")

    found = graphs.window(Breaks(), lagged.given)
    assert (found.poses.shape, found.error) == ((0, 4, 4), "no more")


def test_the_batch_of_all_factors_is_where_ours_ends(drive, usable):
    whole = graphs.run_ours(drive, SmootherOptions(**VARIANTS["batch"]), usable)
    found = graphs.batch(whole.given)
    ours = whole.final.trajectory.world_T_imu
    assert np.linalg.norm(found.poses[:, :3, 3] - ours[:, :3, 3], axis=1).max() < 1e-3


def test_published_figures_are_marked_and_ours_stand_beside_them():
    outcome = compare("tiny", estimators=["ekf"], data__simulation__frames=8, common_set_from=())
    record = outcome.results.record
    lines = list(published_lines(outcome.runs, {"ekf": 0.5}, record.reference, record.rig.imu_T_cam))
    assert "27 (another machine)" in lines[2]
    assert "not published" in lines[3]
    assert lines[-1].startswith("| `ekf`, filtered |")
    assert lines[-1].endswith("| 0.50 | 54 |")


def test_a_whole_run_takes_time(drive, usable):
    assert cpu(drive, "ekf", usable) > 0.0


def test_statistics_are_read_from_what_evo_saves(tmp_path):
    path = tmp_path / "ape.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("stats.json", json.dumps({"rmse": 1, "mean": 2, "median": 3, "max": 4, "std": 5}))
    found = evo.read_results(path)
    assert (found.rmse, found.mean, found.median, found.max) == (1.0, 2.0, 3.0, 4.0)


def test_errors_of_two_files_are_those_by_hand(tmp_path):
    stamp, pose = 0.1 * np.arange(20), np.tile(np.eye(4), (20, 1, 1))
    pose[:, 0, 3] = np.arange(20)
    pose[:, 1, 3] = np.sin(np.arange(20))
    moved = pose.copy()
    moved[::2, 2, 3] += 0.2
    evo.write_tum(tmp_path / "a.tum", stamp, pose)
    evo.write_tum(tmp_path / "b.tum", stamp, moved)
    found = evo.ours(tmp_path / "a.tum", tmp_path / "b.tum")
    assert found[evo.RPE].rmse == pytest.approx(0.2)
    assert found[evo.APE].rmse == pytest.approx(0.1, rel=0.01)
    assert len(list(evo.Compared(found, found, 1.0, 2.0).lines())) == 7
