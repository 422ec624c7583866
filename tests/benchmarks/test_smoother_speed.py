"""The smoothers' benchmark on tiny drives: it counts right; no time is judged."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import smoother_recording, smoother_settings, smoother_speed
from benchmarks.smoother_speed import PARTS, Bench
from benchmarks.smoothing import smoothed
from benchmarks.timing import Drive
from vislam.estimators.smoother import SmootherEstimator, SmootherOptions


def test_a_timed_run_is_the_run(short, short_config):
    drive = Drive(short_config, short)
    found = smoothed(drive, SmootherOptions())
    solver = SmootherEstimator(drive.problem, SmootherOptions())
    poses = [
        solver.process(frame, np.zeros(len(frame.track), bool)).world_T_imu
        for frame in short.sequence.frames(drive.sigma)
    ]
    assert np.array_equal(found.causal, poses)
    assert np.array_equal(found.estimate.world_T_imu, solver.finalize().world_T_imu)
    assert found.step_time.shape == found.solver_time.shape == (len(short.sequence),)
    assert np.all(found.solver_time > 0.0)
    assert 0.0 < found.outside < 1.0


def test_the_distance_is_of_positions_and_not_aligned():
    poses = np.tile(np.eye(4), (4, 1, 1))
    moved = poses.copy()
    moved[:, :3, 3] += [3.0, 0.0, 4.0]
    assert smoother_settings.distance(moved, poses) == 5.0


def test_every_setting_differs_from_the_shipped_options():
    options = [SmootherOptions(**setting) for setting in smoother_settings.SETTINGS.values()]
    assert options[0] == SmootherOptions()
    assert len(set(options)) == len(options)


@pytest.mark.slow
def test_all_parts_are_measured_and_written(short_config, tmp_path, capsys):
    simulation = replace(short_config.data.simulation, frames=20)
    main = replace(short_config, data=replace(short_config.data, simulation=simulation))
    bench = Bench(main=main, drives=(20, 30), window=5, warm=4, figure=tmp_path / "steps.png")
    smoother_speed.run(bench, list(PARTS), out=tmp_path / "speed.json")
    parts = json.loads((tmp_path / "speed.json").read_text())["parts"]
    assert list(parts) == list(PARTS)
    assert set(parts["recording"]["runs"]) == set(smoother_recording.RUNS)
    for run in parts["recording"]["runs"].values():
        assert 0.0 < run["outside_share"] < 1.0
        assert all(run[key] > 0.0 for key in run if key.endswith(("_of_target", "_ratio")))
    settings = parts["settings"]["settings"]
    assert settings["shipped"]["forward_ratio"] == 1.0
    assert all(0.0 < one["distance_as_is_m"] < 10.0 for one in settings.values())
    assert [run["frames"] for run in parts["growth"]["runs"]] == [20, 30]
    assert all(run["late_ratio"] > 0.0 for run in parts["growth"]["runs"])
    assert (tmp_path / "steps.png").read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert "SIMULATED" in printed
    assert all(f"{name}: " in printed for name in PARTS)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--part", "nonsense"], "--part nonsense: no such part"),
        (["--data", "no/such/folder"], "no/such/folder: no such folder"),
        (["--out", "."], "cannot be written"),
        (["--figure", "."], "cannot be written"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_code_2(arguments, said, capsys):
    assert smoother_speed.main(arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
