"""The simulation as a command: what it writes reads back the same, and nothing is written by halves."""

import numpy as np
import pytest

from vislam.comparison import config as configuration
from vislam.datasets.course_npz import load_course_npz
from vislam.datasets.trajectories import load_reference
from vislam.geometry import se3
from vislam.simulate import main
from vislam.simulation import simulate

DRIVE = """
name: drive
data:
  simulation:
    frames: 50
    path: urban
    tracks_in_view: 15
    duplication_probability: 0.1
    dropped_probability: 0.1
    gyro_bias_walk: 0.001
    clock_offset: 0.02
    extrinsic_axes: [x, -y, -z]
    extrinsic_translation: inverse
    stated_baseline: 0.6
seed: 3
"""
MANY = "name: n\ndata: {simulation: {frames: 2200, tracks_in_view: 70, loss_probability: 1}}\n"


def written(path, text=DRIVE):
    path.write_text(text)
    return str(path)


def test_a_drive_is_written_and_reads_back_the_same(tmp_path, capsys):
    config, out = written(tmp_path / "c.yaml"), tmp_path / "new" / "drive.npz"
    assert main(["--config", config, "--out", str(out)]) == 0
    assert "50 frames" in capsys.readouterr().out
    wanted, truth = simulate(configuration.load(tmp_path / "c.yaml").data.simulation, seed=3, name="drive")
    read = load_course_npz(out)
    assert read.name == "drive"
    for name in ("stamp", "inertial_stamp", "twist", "offset", "track", "pixels"):
        assert np.array_equal(getattr(read, name), getattr(wanted, name)), name
    assert (read.rig.fx, read.rig.cy, read.rig.baseline) == (wanted.rig.fx, wanted.rig.cy, 0.6)
    assert read.rig.imu_T_cam == pytest.approx(wanted.rig.imu_T_cam, abs=1e-12)
    assert read.counts["observations_incomplete"] == 0
    with np.load(out) as archive:
        assert archive["features"].shape == (4, wanted.track.max() + 1, 50)
        assert archive["time_stamps"].shape == (1, 50)
    settings = configuration.ReferenceConfig(file="", format="tum", name="truth", limits="none")
    reference = load_reference(
        tmp_path / "new" / "drive_truth.tum", settings, imu_T_cam=np.eye(4), stamp=read.stamp
    )
    assert np.abs(se3.local(truth.world_T_imu, reference.pose)).max() < 1e-8


def test_the_seed_decides_and_equal_seeds_give_equal_bytes(tmp_path):
    config = written(tmp_path / "c.yaml")
    bytes_of = {}
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        out = tmp_path / name / "drive.npz"
        assert main(["--config", config, "--out", str(out), "--seed", seed]) == 0
        bytes_of[name] = out.read_bytes(), (tmp_path / name / "drive_truth.tum").read_bytes()
    assert bytes_of["a"] == bytes_of["b"]
    assert bytes_of["a"][0] != bytes_of["c"][0]
    assert bytes_of["a"][1] != bytes_of["c"][1]


@pytest.mark.parametrize(
    ("text", "arguments", "said"),
    [
        ("name: n\ndata: {file: 03.npz}\n", [], "data.simulation is missing"),
        ("name: n\ndata: {simulation: {path: spiral}}\n", [], "data.simulation.path"),
        (DRIVE, ["--set", "data.simulation.inertial_noise=step"], "must be sample"),
        (DRIVE, ["--seed", "-1"], "seed"),
        (DRIVE, ["--set", "data.simulation.path=recorded"], "go together"),
        (MANY, [], "simulate fewer frames"),
    ],
)
def test_bad_input_is_one_line_exit_code_2_and_no_file(tmp_path, capsys, text, arguments, said):
    config, out = written(tmp_path / "c.yaml", text), tmp_path / "drive.npz"
    assert main(["--config", config, "--out", str(out), *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"]


ALONG = "name: n\ndata: {simulation: {frames: 20, path: recorded, recorded: {file: p.txt, format: kitti}}}\n"


def test_a_drive_along_recorded_poses_finds_them_in_the_named_folder(tmp_path, capsys):
    config, out = written(tmp_path / "c.yaml", ALONG), tmp_path / "drive.npz"
    (tmp_path / "data").mkdir()
    rows = [f"1 0 0 {1.3 * k} 0 1 0 0 0 0 1 0\n" for k in range(20)]
    (tmp_path / "data" / "p.txt").write_text("".join(rows))
    arguments = ["--config", config, "--out", str(out)]
    assert main([*arguments, "--data-dir", str(tmp_path / "data")]) == 0
    truth = np.loadtxt(tmp_path / "drive_truth.tum")
    assert truth[:, 1] == pytest.approx(1.3 * np.arange(20), abs=1e-6)
    capsys.readouterr()
    assert main([*arguments, "--data-dir", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "p.txt: not found" in error
    assert error.count("\n") == 1


def test_neither_file_is_left_if_one_cannot_be_written(tmp_path, capsys):
    config, out = written(tmp_path / "c.yaml"), tmp_path / "drive.npz"
    (tmp_path / "drive_truth.tum").mkdir()
    assert main(["--config", config, "--out", str(out)]) == 2
    assert "drive_truth.tum" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["c.yaml", "drive_truth.tum"]


def test_neither_file_is_left_if_writing_breaks_off(tmp_path, monkeypatch):
    def fail(*_):
        raise RuntimeError("disk full")

    monkeypatch.setattr("vislam.datasets.export.write_tum", fail)
    config = written(tmp_path / "c.yaml")
    with pytest.raises(RuntimeError, match="disk full"):
        main(["--config", config, "--out", str(tmp_path / "drive.npz")])
    assert [path.name for path in tmp_path.iterdir()] == ["c.yaml"]
