"""The measurements of time on tiny drives: they count right, and give what is finite; no time is judged."""

import json
from dataclasses import replace

import numpy as np
import pytest

from experiments import floor, speed
from experiments.floor import VARIANTS
from experiments.inside_gtsam import smoothed
from experiments.speed import PARTS, Bench
from experiments.textbook import through
from experiments.timing import Drive, timed
from vislam.estimators.smoother import SmootherEstimator, SmootherOptions


@pytest.fixture(scope="module")
def drive(short, short_config) -> Drive:
    return Drive(short_config, short)


@pytest.mark.parametrize("member", VARIANTS)
def test_the_sizes_that_are_replayed_are_those_of_the_run(drive, member):
    run = timed(drive, VARIANTS[member])
    sequence = drive.sequence
    held = np.array([sizes.known + sizes.new for sizes in run.sizes])
    assert len(run.sizes) == len(run.step_time) == len(sequence)
    assert [sizes.held for sizes in run.sizes] == [0, *held[:-1]]
    assert all(sizes.fused <= sizes.known <= sizes.held for sizes in run.sizes)
    assert sum(sizes.new for sizes in run.sizes) == len(np.unique(sequence.track))
    assert min(floor.replay(run.sizes, VARIANTS[member], repeats=1)) > 0.0


def test_the_cubic_finds_the_curve_that_the_times_lie_on():
    at = np.linspace(1.0, 50.0, 20)
    assert np.allclose(through(at, 2e-3 + 3e-6 * at**3), [2e-3, 0.0, 0.0, 3e-6], rtol=1e-6, atol=1e-12)


def test_a_smoother_that_is_timed_is_the_smoother(drive):
    found = smoothed(drive, SmootherOptions())
    solver = SmootherEstimator(drive.problem, SmootherOptions())
    for frame in drive.sequence.frames(drive.sigma):
        solver.process(frame)
    assert np.array_equal(found.final.trajectory.world_T_imu, solver.finalize().trajectory.world_T_imu)
    assert found.step_time.shape == found.solver_time.shape == (len(drive.sequence),)
    assert np.all(found.solver_time > 0.0)
    assert 0.0 < found.outside < 1.0


@pytest.mark.slow
def test_all_parts_are_measured_and_written(short_config, tmp_path, capsys):
    simulation = replace(short_config.data.simulation, frames=20)
    few = replace(short_config, data=replace(short_config.data, simulation=simulation))
    wide = replace(few, data=replace(few.data, simulation=replace(simulation, tracks_in_view=80)))
    bench = Bench(
        main=few,
        many_tracks=wide,
        repeats=1,
        seconds=0.01,
        thinned=8,
        drives={"ekf": (20, 30), "isam2": (20,)},
        window=5,
        warm=4,
    )
    speed.run(bench, list(PARTS), out=tmp_path / "speed.json")
    document = json.loads((tmp_path / "speed.json").read_text(encoding="utf-8"))
    assert list(document["parts"]) == list(PARTS)
    assert {"cpu", "date", "numpy", "scipy", "blas"} <= set(document["provenance"])
    numbers = list(ratios(document["parts"]))
    assert len(numbers) >= 18
    assert all(np.isfinite(number) and number > 0.0 for number in numbers)
    runs = document["parts"]["growth"]["runs"]
    assert [(run["estimator"], run["frames"]) for run in runs] == [
        ("ekf", 20),
        ("ekf", 30),
        ("isam2", 20),
    ]
    printed = capsys.readouterr().out
    assert "SIMULATED" in printed
    assert all(f"{name}: " in printed for name in PARTS)


def ratios(tree):
    """All numbers below keys that name a ratio, a share or an exponent."""
    for key, value in tree.items() if isinstance(tree, dict) else enumerate(tree):
        if isinstance(value, dict) or (isinstance(value, list) and value and isinstance(value[0], dict)):
            yield from ratios(value)
        elif any(word in str(key) for word in ("ratio", "share", "exponent")):
            yield from np.atleast_1d(value)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--part", "nonsense"], "--part nonsense: no such part"),
        (["--seconds", "0"], "--seconds 0"),
        (["--data", "no/such/folder"], "no/such/folder: no such folder"),
        (["--out", "."], "cannot be written"),
    ],
)
def test_bad_arguments_are_one_line_and_exit_code_2(arguments, said, capsys):
    assert speed.main(arguments) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("given", ["ekf", "ekf=many", "nobody=1000", "ekf=699"])
def test_a_drive_that_is_none_is_refused_in_one_line(given, capsys):
    assert speed.main(["--part", "growth", "--drive", given]) == 2
    assert f"--drive {given}: expected NAME=FRAMES" in capsys.readouterr().err
