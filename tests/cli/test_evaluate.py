"""Scoring saved runs again: the same bytes, and trajectories from elsewhere beside them."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from vislam import compare, evaluate
from vislam.core.record import Record
from vislam.core.run import Run
from vislam.geometry import se3

ROOT = Path(__file__).parents[2]
TURN = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From a camera's axes to x forward, y left, z up."""


def compared(out, *options):
    """Results of a short comparison."""
    config = str(ROOT / "configs" / "tiny.yaml")
    arguments = ["--config", config, "--out", str(out), "--estimators", "dead_reckoning,ekf", *options]
    assert compare.main(arguments) == 0
    (folder,) = out.iterdir()
    return folder


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Those without a page, which nobody may change."""
    return compared(tmp_path_factory.mktemp("made"), "--no-report")


@pytest.fixture
def folder(made, tmp_path):
    """A copy of them."""
    return Path(shutil.copytree(made, tmp_path / "results"))


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Those with their page, which nobody may change."""
    return compared(tmp_path_factory.mktemp("drawn"))


@pytest.fixture
def drawn_copy(drawn, tmp_path):
    """A copy of them."""
    return Path(shutil.copytree(drawn, tmp_path / "results"))


def contents(folder):
    return {path.relative_to(folder): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def values(folder):
    document = json.loads((folder / "metrics.json").read_text())
    return {(m["estimator"], m["key"]): m["value"] for m in document["metrics"]}


@pytest.mark.slow
def test_the_same_bytes_come_out_again(drawn, drawn_copy):
    for name in ("metrics.json", "report.html"):
        (drawn_copy / name).unlink()
    assert evaluate.main([str(drawn_copy)]) == 0
    assert contents(drawn_copy) == contents(drawn)


@pytest.mark.slow
def test_another_folder_leaves_the_results_alone(drawn, drawn_copy, tmp_path):
    assert evaluate.main([str(drawn_copy), "--out", str(tmp_path / "again")]) == 0
    assert contents(drawn_copy) == contents(drawn)
    again = contents(tmp_path / "again")
    assert again == {path: data for path, data in contents(drawn).items() if path in again}
    assert {str(path) for path in again} >= {"metrics.json", "report.html"}


@pytest.mark.slow
def test_a_trajectory_from_elsewhere_is_one_more_column(folder, tmp_path):
    run, record = Run.load(folder / "runs" / "ekf.npz"), Record.load(folder / "record.npz")
    camera = se3.inverse(TURN) @ run.final.world_T_imu @ record.rig.imu_T_cam
    np.savetxt(tmp_path / "camera.txt", camera[:, :3].reshape(-1, 12))
    third = [line for k, line in enumerate((folder / "ekf.tum").read_text().splitlines()) if k % 3 == 0]
    (tmp_path / "third.tum").write_text("\n".join(third))
    given = ["--trajectory", f"orb={tmp_path / 'camera.txt'},format=kitti,pose_of=left_camera,up=-y"]
    given += ["--trajectory", f"some={tmp_path / 'third.tum'}"]
    assert evaluate.main([str(folder), *given]) == 0
    found = values(folder)
    assert np.isclose(found["orb", "ate_rmse"], found["ekf", "ate_rmse"], rtol=1e-9)
    assert np.isclose(found["some", "ate_rmse"], found["ekf", "ate_rmse"], rtol=0.3)
    assert found["some", "frames"] == 10
    assert ("orb", "total_time_s") not in found
    page = (folder / "report.html").read_text()
    assert "frames without a pose" in page
    document = json.loads((folder / "metrics.json").read_text())
    assert document["runs"]["some"]["counts"] == {"frames_without_a_pose": 20}
    # They are not kept: the next evaluation is of the runs alone.
    assert evaluate.main([str(folder)]) == 0
    assert ("orb", "ate_rmse") not in values(folder)


BAD_TRAJECTORIES = {
    "no name": ("ekf.tum", "expected NAME=FILE"),
    "a taken name": ("ekf=ekf.tum", "a run called ekf already"),
    "an unknown key": ("orb=ekf.tum,scale=2", "expected NAME=FILE"),
    "an unknown format": ("orb=ekf.tum,format=csv", "--trajectory orb.format: Input should be 'planar_xy'"),
    "no poses": ("orb=ekf.tum,format=planar_xy", "planar_xy holds no poses"),
    "no file": ("orb=nowhere.tum", "nowhere.tum: not found"),
    "another format": ("orb=ekf.tum,format=kitti", "ekf.tum"),
}


@pytest.mark.parametrize("case", sorted(BAD_TRAJECTORIES))
def test_bad_trajectories_get_one_line_and_2(case, made, folder, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    text, message = BAD_TRAJECTORIES[case]
    assert evaluate.main([str(folder), "--trajectory", text]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert contents(folder) == contents(made)


def broken(folder, name):
    (folder / name).write_bytes((folder / name).read_bytes()[:200])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (shutil.rmtree, "expected the results folder of a comparison"),
        (lambda folder: (folder / "record.npz").unlink(), "record.npz: expected the saved record of a drive"),
        (lambda folder: broken(folder, "record.npz"), "record.npz: expected the saved record of a drive"),
        (lambda folder: broken(folder, "runs/ekf.npz"), "ekf.npz: expected a run"),
    ],
    ids=["no folder", "no record", "half a record", "half a run"],
)
def test_bad_results_get_one_line_and_2(change, message, folder, capsys):
    change(folder)
    assert evaluate.main([str(folder)]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


def test_what_a_stopped_comparison_has_left_is_scored(folder, capsys):
    (folder / "runs" / "ekf.npz").unlink()
    assert evaluate.main([str(folder), "--no-report"]) == 1
    assert "ekf is incomplete: not run; run the comparison again" in capsys.readouterr().out
    runs = json.loads((folder / "metrics.json").read_text())["runs"]
    assert [name for name, run in runs.items() if run["complete"]] == [name for name in runs if name != "ekf"]


def test_a_record_survives_its_file(folder, tmp_path):
    record = Record.load(folder / "record.npz")
    record.save(tmp_path / "again.npz")
    again = Record.load(tmp_path / "again.npz")
    assert again.repairs == record.repairs
    assert again.notes == record.notes
    assert np.array_equal(again.rig.imu_T_cam, record.rig.imu_T_cam)
    assert np.array_equal(again.reference.bias, record.reference.bias)
    assert np.array_equal(again.given.z, record.given.z)


def test_runs_from_which_no_track_was_held_out_are_scored_again(tmp_path):
    arguments = ["--config", str(ROOT / "configs" / "tiny.yaml"), "--set", "held_out.share=0"]
    arguments += ["--estimators", "dead_reckoning", "--out", str(tmp_path), "--no-report"]
    assert compare.main(arguments) == 0
    (folder,) = tmp_path.iterdir()
    assert evaluate.main([str(folder), "--no-report"]) == 0
