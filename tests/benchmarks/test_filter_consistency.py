"""The Monte-Carlo of the filters: its drives are what the filters are told, and it writes what it finds."""

import json

import numpy as np
import pytest

from benchmarks.drives import LEVELS, drive
from benchmarks.filter_consistency import MOTION_ALONE, main, measure, summaries
from benchmarks.variants import VARIANTS


@pytest.mark.parametrize("level", LEVELS)
def test_the_motion_noise_is_that_which_is_told(level):
    """Dead reckoning is right about itself over a second, in which next to nothing is linearised."""
    found = summaries([measure(level, seed, 10, {}) for seed in range(40)])[MOTION_ALONE]
    assert found.anees["pose"].overall_low < 1.0 < found.anees["pose"].overall_high
    assert found.anees["pose"].overall_high - found.anees["pose"].overall_low < 0.5
    assert found.anees["pose"].share_inside >= 0.8


def test_the_pixel_noise_is_that_which_is_told():
    level = LEVELS["kitti07"]
    sequence, problem, truth = drive(level, frames=30, seed=1)
    assert np.array_equal(problem.track_noise.sigma, level.pixel_sigma * np.sqrt([1.0, 1.0, 0.5]))
    rows = sequence.pixels[:, 1] - sequence.pixels[:, 3]
    assert np.isclose(rows.std(), np.sqrt(2.0) * level.pixel_sigma, rtol=0.1)
    assert np.linalg.norm(truth[0] - np.eye(4)) < 1e-3


def test_a_seed_is_a_drive():
    one, same, other = (drive(LEVELS["small"], frames=5, seed=seed)[0] for seed in (3, 3, 4))
    assert np.array_equal(one.twist, same.twist)
    assert np.array_equal(one.pixels, same.pixels)
    assert not np.array_equal(one.twist, other.twist)


@pytest.mark.slow
def test_the_command_writes_numbers_and_figures(tmp_path, capsys):
    arguments = ["--drives", "2", "--frames", "20", "--levels", "small", "--processes", "1"]
    assert main([*arguments, "--out", str(tmp_path)]) == 0
    assert "average NEES" in capsys.readouterr().out
    document = json.loads((tmp_path / "consistency.json").read_text(encoding="utf-8"))
    found = document["levels"]["small"]["estimators"]
    assert list(found) == [MOTION_ALONE, *VARIANTS]
    assert len(found["ekf"]["anees"]["pose"]["value"]) == 20
    assert found["ekf"]["gained"][-1][2] > 1.0 > found["ekf_fej"]["gained"][-1][2]
    for key in ("anees", "coverage", "observability"):
        assert (tmp_path / f"{key}_small.png").stat().st_size > 10_000


@pytest.mark.slow
def test_the_invariant_filter_is_consistent_and_the_standard_one_is_not():
    variants = {name: VARIANTS[name] for name in ("ekf", "ekf_invariant", "ekf_invariant, point")}
    found = summaries([measure("kitti07", seed, 200, variants) for seed in range(12)])
    standard = found["ekf"].anees["pose"]
    for name in ("ekf_invariant", "ekf_invariant, point"):
        invariant = found[name].anees["pose"]
        assert 0.7 < invariant.overall < 1.3
        assert invariant.share_inside > 0.9
        assert found[name].coverage.min() > 0.98
        assert standard.overall > 1.3 * invariant.overall
    assert standard.overall_low > 1.0
