"""The ranking by held-out tracks: its errors, its runs, and what the command finds on a short drive."""

import json
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.held_out_errors import AXES, errors
from benchmarks.held_out_ranking import SCORES, SIMULATED, main
from benchmarks.held_out_runs import VARIANTS, Given
from benchmarks.timing import Drive
from vislam.base.errors import DataError
from vislam.geometry import se3

RUNS = (
    "eks",
    "eks, tracks: a twentieth",
    "eks, camera: 1 deg",
    "dead reckoning",
    "dead reckoning, bias known",
)


@pytest.fixture(scope="module")
def drive():
    return Drive.open(replace(SIMULATED, seed=1)).first(100)


def test_errors_are_those_that_were_made(drive):
    reference, rig = drive.dataset.reference, drive.dataset.sequence.rig
    right = errors(reference.pose[:100], reference, rig)
    assert max(getattr(right, key) for key in AXES) < 1e-6
    # Steps of the camera, each too long by a tenth.
    camera = reference.pose[:100] @ rig.imu_T_cam
    camera[:, :3, 3] *= 1.1
    longer = errors(camera @ rig.cam_T_imu, reference, rig)
    assert np.isclose(longer.way_10, 10.0, rtol=0.1)
    assert longer.turn_10 < 1e-6
    assert longer.across_10 < 0.2 * longer.way_10 / 10.0
    # A camera that turns by a degree at one frame: seen in every stretch that goes over it.
    turned = reference.pose[:100].copy()
    turned[30:] = (
        turned[30] @ se3.exp(np.deg2rad([0, 0, 1.0, 0, 0, 0])) @ se3.inverse(turned[30]) @ turned[30:]
    )
    once = errors(turned, reference, rig)
    assert 0.01 < once.turn_10 < 0.5
    # At 20 m, and at up to 10 m more where the turn comes early in the stretch.
    assert 20.0 < once.across_10 / np.deg2rad(once.turn_10) < 32.0
    with pytest.raises(DataError, match="100 m"):
        errors(reference.pose[:20], reference, rig)


def test_runs_differ_by_what_is_changed_alone(drive):
    held = drive.dataset.sequence.track % 10 == 0
    given = Given.without(drive, held)
    assert given.sequence.observations == np.count_nonzero(~held) == len(given.sigma)
    changed = {
        name: variant.change(given) for name, variant in VARIANTS.items() if variant.of != "dead_reckoning"
    }
    as_it_is = [name for name, other in changed.items() if other is given]
    assert as_it_is == [name for name in changed if "," not in name or "outliers" in name]
    for name, other in changed.items():
        assert np.isin(other.sequence.row, given.sequence.row).all()
        assert len(other.sigma) == other.sequence.observations
        same = other.problem is given.problem and other.sequence is given.sequence
        assert same == (name in as_it_is)
    later = changed["eks, clock: + 0.1 s"].sequence.clock_offset - given.sequence.clock_offset
    assert np.isclose(later, 0.1)
    less = given.sequence.disparity - changed["eks, disparities: - 1 px"].sequence.disparity
    assert np.allclose(less, 1.0)


@pytest.mark.slow
def test_held_out_tracks_rank_a_short_drive_as_the_truth_does(tmp_path, capsys):
    out, figure = tmp_path / "ranking.json", tmp_path / "ranking.png"
    options = ["--data", "simulated", "--frames", "120", "--seed", "1", "--out", str(out)]
    assert main([*options, "--figure", str(figure), "--runs", *RUNS]) == 0
    assert "Spearman" in capsys.readouterr().out
    parts = json.loads(out.read_text(encoding="utf-8"))["parts"]
    runs = parts["runs"]["runs"]
    assert list(runs) == list(RUNS)
    assert runs["dead reckoning"]["median"] > 1.5 * runs["eks"]["median"]
    assert parts["runs"]["reference"]["name"] == "truth"
    assert parts["runs"]["reference"]["median"] < min(run["median"] for run in runs.values())
    found = {(one["score"], one["error"]): one["spearman"] for one in parts["ranks"]["correlations"]}
    assert set(found) == {(name, key) for name in SCORES for key in AXES}
    assert found["median", "across_10"] > 0.8
    assert found["median", "turn_10"] > 0.5
    assert figure.stat().st_size > 10_000


def test_a_file_that_cannot_be_written_is_an_error_before_anything_runs(tmp_path, capsys):
    (tmp_path / "file").write_text("", encoding="utf-8")
    assert main(["--out", str(tmp_path / "file" / "ranking.json")]) == 2
    assert "cannot be written" in capsys.readouterr().err
