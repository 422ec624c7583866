"""The command itself: what it leaves behind, and how it answers bad input."""

import io
import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from vislam.compare import main
from vislam.report.markdown import results_table

ROOT = Path(__file__).parents[2]
TINY = str(ROOT / "configs" / "tiny.yaml")
DS3 = str(ROOT / "configs" / "ds3.yaml")


@pytest.fixture(autouse=True)
def no_data(monkeypatch, tmp_path):
    monkeypatch.delenv("VISLAM_DATA", raising=False)
    monkeypatch.chdir(tmp_path)


def course_file(path, **changes):
    """A small course file, good unless changed; a key changed to None is left out."""
    frames, tracks = 6, 8
    features = np.full((4, tracks, frames), -1.0)
    stereo = np.array([300.0, 200.0, 280.0, 200.0])
    for track in range(tracks):
        features[:, track, :4] = (stereo + track * np.array([9.0, 5.0, 9.0, 5.0]))[:, None]
        features[0, track, :4] += np.arange(4)
        features[2, track, :4] += np.arange(4)
    arrays = {
        "time_stamps": 0.1 * np.arange(frames)[None],
        "features": features,
        "linear_velocity": np.ones((3, frames)),
        "angular_velocity": np.zeros((3, frames)),
        "K": np.array([[500.0, 0, 320], [0, 500.0, 240], [0, 0, 1]]),
        "b": np.array(0.5),
        "imu_T_cam": np.array([[0, 0, 1.0, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]]),
    }
    arrays.update(changes)
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})


def config_file(path, text):
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.slow
def test_every_repair_is_in_the_report_on_or_off(tmp_path):
    switched = ["--set", "data.repair.consensus=false", "--estimators", "dead_reckoning"]
    assert main(["--config", TINY, "--out", str(tmp_path / "out"), *switched]) == 0
    (folder,) = (tmp_path / "out").iterdir()
    steps = {
        step["name"]: step for step in json.loads((folder / "metrics.json").read_text())["dataset"]["repairs"]
    }
    assert steps["duplicated_tracks"]["applied"]
    assert steps["duplicated_tracks"]["counts"]["duplicated_frames"] > 0
    assert steps["clock"]["options"] == {"offset": 0.05}
    assert not steps["consensus"]["applied"]
    page = (folder / "report.html").read_text()
    assert '<th scope="row">duplicated tracks</th><td>on</td>' in page
    assert '<th scope="row">consensus</th><td>off</td>' in page


@pytest.mark.slow
def test_tiny_leaves_everything_behind(tmp_path, capsys):
    assert main(["--config", TINY, "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert shown.splitlines()[1].startswith("SIMULATED")
    assert "[SIMULATED]" in shown
    (folder,) = (tmp_path / "out").iterdir()
    names = {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
    wanted = {
        "config.yaml",
        "metrics.json",
        "record.npz",
        "report.html",
    }
    drawn = ["top_view", "height_attitude", "nis", "step_time", "observations"]
    of_each = (
        "error",
        "error_path",
        "components",
        "relative",
        "bands",
        "nees",
        "coverage",
        "segments",
        "cost",
    )
    for name in of_each:
        drawn += [f"{name}_filtered", f"{name}_smoothed"]
    wanted |= {f"figures/{name}.svg" for name in drawn}
    wanted.add("list/ekf_invariant.npz")
    for estimator in ("dead_reckoning", "ekf", "isam2"):
        wanted |= {f"{estimator}.tum", f"{estimator}.ply", f"runs/{estimator}.npz"}
        wanted |= {f"{estimator}_kitti.txt", f"{estimator}_trajectory.npz"}
    assert names == wanted
    document = json.loads((folder / "metrics.json").read_text())
    assert document["schema_version"] == 2
    assert document["dataset"]["synthetic"] is True
    assert document["dataset"]["reference"] == "truth"
    value = {(m["estimator"], m["key"]): m["value"] for m in document["metrics"]}
    for estimator in ("dead_reckoning", "ekf", "isam2"):
        for key in (
            "ate_rmse",
            "path_length",
            "step_time_p50_ms",
            "step_time_p95_ms",
            "total_time_s",
            "peak_rss_mb",
            "landmarks",
            "observations_used",
            "observations_gated",
        ):
            assert (estimator, key) in value
        lines = np.loadtxt(folder / f"{estimator}.tum")
        assert lines.shape == (30, 8)
    assert value["ekf", "ate_rmse"] < 0.1
    # Half of the points are nearer than 25 m, where half a pixel is worth 1 m.
    assert value["ekf", "map_error_median"] < 2.0
    assert value["isam2", "map_error_median"] < 2.0
    assert value["isam2", "ate_rmse"] < 0.1
    page = (folder / "report.html").read_text()
    assert "[SIMULATED]" in page
    assert page.count("<figure ") == len(drawn)
    table = results_table(document)
    assert "simulation (SIMULATED) against truth" in table
    assert f"| {value['ekf', 'ate_rmse']:.3f} |" in table


@pytest.mark.slow
def test_without_a_report_there_are_the_numbers(tmp_path, capsys):
    assert main(["--config", TINY, "--out", "out", "--no-report", "--estimators", "ekf"]) == 0
    (folder,) = (tmp_path / "out").iterdir()
    assert capsys.readouterr().out.endswith(f"metrics: out/{folder.name}/metrics.json\n")
    assert not list(folder.rglob("*.html")) + list(folder.rglob("*.svg"))
    numbers = json.loads((folder / "metrics.json").read_text())
    assert main(["--config", TINY, "--out", "out", "--estimators", "ekf"]) == 0
    again = json.loads((folder / "metrics.json").read_text())
    timed = ("_ms", "_time_s", "_rss_mb")
    for one, other in zip(numbers["metrics"], again["metrics"], strict=True):
        assert one == other or one["key"].endswith(timed)


def test_a_rerun_lands_in_the_same_place_with_the_same_numbers(tmp_path):
    for _ in range(2):
        assert main(["--config", TINY, "--out", "out", "--no-report", "--estimators", "ekf"]) == 0
    (folder,) = (tmp_path / "out").iterdir()
    first = np.loadtxt(folder / "ekf.tum")
    assert main(["--config", TINY, "--out", "other", "--no-report", "--estimators", "ekf"]) == 0
    (other,) = (tmp_path / "other").iterdir()
    assert np.array_equal(first, np.loadtxt(other / "ekf.tum"))
    assert folder.name == other.name


def test_a_recorded_file_is_read_and_its_missing_reference_is_said(tmp_path, capsys):
    course_file(tmp_path / "small.npz")
    text = (
        "name: s\ndata: {file: small.npz, reference: {file: no.txt, format: planar_xy, name: r, limits: l}}\n"
    )
    config = config_file(tmp_path / "c.yaml", text)
    assert main(["--config", config, "--data-dir", str(tmp_path), "--estimators", "ekf", "--no-report"]) == 0
    assert "no.txt not found" in capsys.readouterr().out
    document = json.loads(next((tmp_path / "results").rglob("metrics.json")).read_text())
    assert document["dataset"]["synthetic"] is False
    assert document["dataset"]["reference"] is None


@pytest.mark.slow
def test_a_failed_estimator_gives_1_and_keeps_what_it_had_done(tmp_path, capsys, monkeypatch):
    from vislam.base.errors import DivergedError
    from vislam.estimators.ekf import EkfEstimator

    whole = EkfEstimator.process

    def failing(self, frame):
        if frame.k == 12:
            raise DivergedError("covariance lost, smallest variance -1")
        return whole(self, frame)

    monkeypatch.setattr(EkfEstimator, "process", failing)
    assert main(["--config", TINY, "--out", "out"]) == 1
    shown = capsys.readouterr().out
    assert "INCOMPLETE (12 of 30)" in shown
    assert "frame 12: DivergedError: covariance lost" in shown
    (folder,) = (tmp_path / "out").iterdir()
    assert len(np.loadtxt(folder / "ekf.tum")) == 12
    assert len(np.loadtxt(folder / "isam2.tum")) == 30
    document = json.loads((folder / "metrics.json").read_text())
    assert document["runs"]["ekf"]["complete"] is False
    assert "incomplete" in (folder / "report.html").read_text()


def test_a_missing_recording_is_simulated_unless_that_is_refused(capsys):
    assert main(["--config", DS3, "--no-substitute", "--out", "out"]) == 2
    message = capsys.readouterr().err
    assert "03.npz: not found in " in message
    assert ", ., data, " in message
    assert "--data-dir" in message
    assert not Path("out").exists()
    short = ["--set", "data.simulation.frames=20", "--estimators", "ekf"]
    assert main(["--config", DS3, "--out", "out", "--no-report", *short]) == 0
    begun, simulated, *_ = capsys.readouterr().out.splitlines()
    assert begun == f"vislam compare {DS3}"
    assert simulated.startswith("SIMULATED: synthetic substitute for 03.npz")


def object_array():
    out = np.empty(2, dtype=object)
    out[:] = [pickle, 1]
    return np.array([{"a": 1}], dtype=object)


BAD_FILES = {
    "a missing key": ({"K": None}, "'K' is missing"),
    "wrong shape": ({"angular_velocity": np.zeros((3, 5))}, "'angular_velocity' must be of shape (3, 6)"),
    "features of another length": (
        {"features": np.zeros((4, 8, 7))},
        "'features' must be of shape (4, M, 6)",
    ),
    "NaN stamps": (
        {"time_stamps": np.array([[0, 1, np.nan, 3, 4, 5.0]])},
        "'time_stamps' must be free of NaN",
    ),
    "unsorted stamps": (
        {"time_stamps": np.array([[0, 1, 3, 2, 4, 5.0]])},
        "'time_stamps' must be increasing",
    ),
    "no intrinsic matrix": ({"K": np.eye(3)[::-1]}, "'K' must be an intrinsic matrix"),
    "no rigid extrinsic": ({"imu_T_cam": 2.0 * np.eye(4)}, "'imu_T_cam' must be a rigid transform"),
    "negative baseline": ({"b": np.array(-0.5)}, "'b' must be one baseline > 0"),
    "pickled objects": ({"b": object_array()}, "pickled objects are rejected"),
    "text": ({"K": np.array([["a"] * 3] * 3)}, "'K' must be a plain array of real numbers"),
    "NaN features": ({"features": np.full((4, 8, 6), np.nan)}, "'features' must be free of NaN"),
    "nothing seen": ({"features": np.full((4, 8, 6), -1.0)}, "no stereo observation is left"),
}


@pytest.mark.parametrize("case", sorted(BAD_FILES))
def test_bad_files_get_one_line_and_2(case, tmp_path, capsys):
    changes, message = BAD_FILES[case]
    course_file(tmp_path / "small.npz", **changes)
    config = config_file(tmp_path / "c.yaml", "name: s\ndata: {file: small.npz}\n")
    assert main(["--config", config, "--data-dir", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not (tmp_path / "results").exists()


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.95])
def test_a_file_cut_short_gets_one_line_and_2(share, tmp_path, capsys):
    buffer = io.BytesIO()
    course_file(buffer)
    whole = buffer.getvalue()
    (tmp_path / "small.npz").write_bytes(whole[: int(share * len(whole))])
    config = config_file(tmp_path / "c.yaml", "name: s\ndata: {file: small.npz}\n")
    assert main(["--config", config, "--data-dir", str(tmp_path)]) == 2
    assert "not a whole npz archive" in capsys.readouterr().err


BAD_CONFIGS = {
    "unknown key": (
        "name: s\ndata: {simulation: {frames: 9, wheels: 4}}\n",
        "data.simulation.wheels: unknown key",
    ),
    "unknown top key": ("name: s\ndata: {simulation: {}}\nnoize: {}\n", "noize: unknown key"),
    "out of range": (
        "name: s\ndata: {simulation: {}}\nnoise: {pixel_sigma_px: -2}\n",
        "noise.pixel_sigma_px",
    ),
    "wrong type": ("name: s\ndata: {simulation: {frames: many}}\n", "data.simulation.frames"),
    "bad axes": ("name: s\ndata: {file: a.npz, repair: {axes: {body: [x, y, -z]}}}\n", "right-handed"),
    "unknown repair": ("name: s\ndata: {file: a.npz, repair: {axis: true}}\n", "known are axes, baseline"),
    "unknown option of a repair": (
        "name: s\ndata: {file: a.npz, repair: {disparity: {least: 3}}}\n",
        "known are minimum_px, row_difference_px",
    ),
    "no data": ("name: s\ndata: {}\n", "one of source, file, simulation and packaged must be given"),
    "missing data": ("name: s\n", "data: "),
    "not a mapping": ("- 1\n", "expected a mapping"),
    "not YAML": ("a: [1\n", "not a YAML file"),
    "unknown estimator": (
        "name: s\ndata: {simulation: {frames: 9}}\nestimators: {ukf: {}}\n",
        "estimators.ukf: no such estimator; installed are batch, batch_gnc, batch_schur, dead_reckoning",
    ),
    "unknown estimator behind a name": (
        "name: s\ndata: {simulation: {frames: 9}}\nestimators: {mine: {estimator: ukf}}\n",
        "estimators.mine.estimator: ukf: no such estimator; installed are batch, batch_gnc, batch_schur",
    ),
    "no name of an estimator": (
        "name: s\ndata: {simulation: {frames: 9}}\nestimators: {mine: {estimator: 3}}\n",
        "estimators.mine.estimator: Input should be a valid string, got 3",
    ),
    "no name of a file": (
        "name: s\ndata: {simulation: {frames: 9}}\nestimators: {../mine: {estimator: ekf}}\n",
        "estimators.../mine: expected letters",
    ),
    "unknown option": (
        "name: s\ndata: {simulation: {frames: 9}}\nestimators: {isam2: {lag: 3}}\n",
        "estimators.isam2.lag: unknown key",
    ),
}


@pytest.mark.parametrize("case", sorted(BAD_CONFIGS))
def test_bad_configs_get_one_line_and_2(case, tmp_path, capsys):
    text, message = BAD_CONFIGS[case]
    assert main(["--config", config_file(tmp_path / "c.yaml", text)]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not (tmp_path / "results").exists()


def test_a_missing_config_gets_2(capsys):
    assert main(["--config", "nowhere.yaml"]) == 2
    assert "nowhere.yaml: cannot be read" in capsys.readouterr().err


def test_the_effective_config_can_be_fed_back(tmp_path, capsys):
    assert main(["--config", TINY, "--dump-config", "--set", "noise.pixel_sigma_px=0.7"]) == 0
    text = capsys.readouterr().out
    assert "pixel_sigma_px: 0.7" in text
    assert main(["--config", config_file(tmp_path / "c.yaml", text), "--dump-config"]) == 0
    assert capsys.readouterr().out == text


@pytest.mark.slow
def test_as_a_process_it_is_quiet_but_for_table_and_path(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "vislam.compare", "--config", TINY, "--estimators", "dead_reckoning,ekf"],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "agg"},
    )
    assert done.returncode == 0
    assert done.stderr == ""
    assert done.stdout.strip().endswith("report.html")
    assert "\x1b" not in done.stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "file", "limits"),
    [
        ("ds3", "03.npz", {"ekf": 4.0, "isam2": 2.0}),
        ("kitti07", "0027.npz", {"ekf": 9.0, "isam2": 4.5}),
        ("ds3_smoothers", "03.npz", {"ekf": 4.0, "batch": 1.7}),
        ("kitti07_smoothers", "0027.npz", {"ekf": 9.0, "batch": 3.5}),
    ],
)
def test_the_recorded_drives_are_as_accurate_as_promised(name, file, limits, tmp_path):
    from tests.conftest import recorded

    folder = recorded(file).parent
    config = str(ROOT / "configs" / f"{name}.yaml")
    chosen = ",".join(["dead_reckoning", *limits])
    asked = ["--config", config, "--estimators", chosen, "--data-dir", str(folder), "--no-substitute"]
    assert main([*asked, "--no-report", "--out", "out"]) == 0
    document = json.loads(next((tmp_path / "out").rglob("metrics.json")).read_text())
    value = {(m["estimator"], m["key"]): m["value"] for m in document["metrics"]}
    key = "ate_planar_rmse" if file == "03.npz" else "ate_rmse"
    assert value["dead_reckoning", key] > 10.0
    for estimator, limit in limits.items():
        assert value[estimator, key] < limit
        if file == "03.npz":
            assert value[estimator, "path_length"] == pytest.approx(1342.0, rel=0.01)
        if name == "ds3_smoothers":
            assert value[estimator, "height_end"] == pytest.approx(7.1, abs=4.0)
