"""The calibration command: the config it writes, and how it answers bad input."""

import re
from pathlib import Path

import pytest
import yaml

from vislam import calibrate, compare, simulate
from vislam.base.errors import DataError, DivergedError, Interrupted
from vislam.calibration.likelihood import Evaluator
from vislam.calibration.output import Output
from vislam.comparison.config import dump, load

CONFIG = """\
name: small
data:
  simulation:
    frames: 30
    tracks_in_view: 15
    gyro_bias: [0.004, -0.003, 0.005]
    clock_offset: 0.05
  repair: {clock: {offset: 0.05}}
noise: {pixel_sigma_px: 0.5, drift_px: 0.05}
estimators: {ekf: {}}
seed: 1
"""
DS3 = str(Path(__file__).parents[2] / "configs" / "ds3.yaml")
FEW = ["--frames", "24"]
"""As many as it takes to leave blocks out."""


@pytest.fixture(autouse=True)
def no_data(monkeypatch, tmp_path):
    monkeypatch.delenv("VISLAM_DATA", raising=False)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def small(tmp_path) -> str:
    path = tmp_path / "small.yaml"
    path.write_text(CONFIG, encoding="utf-8")
    return str(path)


def calibrated(config, *more):
    return calibrate.main(["--config", config, "--processes", "1", *more])


@pytest.mark.slow
def test_the_written_config_is_the_old_one_with_what_was_estimated(small, tmp_path, capsys):
    assert calibrated(small) == 0
    shown = capsys.readouterr().out
    assert shown.startswith("SIMULATED")
    for name in (
        "noise.pixel_sigma_px",
        "noise.drift_px",
        "noise.twist_density (lateral)",
        "noise.twist_density (vertical)",
        "data.repair.clock.offset",
        "bias, gyro x",
        "bias, velocity z",
    ):
        assert name in shown
    assert "(gyro)" not in shown
    assert "NIS per degree of freedom" in shown
    assert shown.rstrip().endswith("config: calibrated.yaml")
    assert {path.name for path in tmp_path.iterdir()} == {"small.yaml", "calibrated.yaml"}
    old, new = load(Path(small)), load(tmp_path / "calibrated.yaml")
    assert new.noise.pixel_sigma_px != old.noise.pixel_sigma_px
    assert new.data.repair.clock.offset != old.data.repair.clock.offset
    assert new.noise.bias_mean == old.noise.bias_mean
    # Gyro and forward velocity were not asked for.
    assert new.noise.twist_density[:4] == old.noise.twist_density[:4]
    assert new.data.simulation == old.data.simulation
    assert new.estimators == old.estimators
    assert new.seed == old.seed


@pytest.mark.slow
def test_the_comparison_takes_the_written_config(small, tmp_path, capsys):
    assert calibrated(small, *FEW, "--out", "folder/mine.yaml") == 0
    capsys.readouterr()
    written = tmp_path / "folder" / "mine.yaml"
    assert compare.main(["--config", str(written), "--dump-config"]) == 0
    assert capsys.readouterr().out == written.read_text(encoding="utf-8")
    assert compare.main(["--config", str(written), "--estimators", "ekf", "--out", "out"]) == 0


@pytest.mark.slow
def test_overridden_values_are_where_it_starts_and_are_written(small, capsys):
    assert calibrated(small, *FEW, "--set", "noise.twist_density=[0.003,0.003,0.003,0.02,0.02,0.02]") == 0
    written = yaml.safe_load(Path("calibrated.yaml").read_text(encoding="utf-8"))
    assert written["noise"]["twist_density"][:3] == [0.003, 0.003, 0.003]


@pytest.mark.slow
def test_inertial_noise_and_disparity_offset_are_estimated_when_asked_for(small, capsys):
    assert calibrated(small, *FEW, "--inertial", "--disparity-offset") == 0
    shown = capsys.readouterr().out
    for name in ("(gyro)", "(forward)", "data.repair.disparity_offset"):
        assert name in shown
    old, new = load(Path(small)), load(Path("calibrated.yaml"))
    assert new.data.repair.disparity_offset is not None
    assert new.noise.twist_density[0] != old.noise.twist_density[0]
    assert len(set(new.noise.twist_density[:3])) == 1


@pytest.mark.slow
def test_the_prior_of_the_bias_can_be_kept(small, capsys):
    assert calibrated(small, *FEW, "--keep-bias-prior") == 0
    old, kept = load(Path(small)).noise, load(Path("calibrated.yaml")).noise
    assert kept.bias_mean == old.bias_mean
    assert kept.bias_sigma == old.bias_sigma
    assert kept.pixel_sigma_px != old.pixel_sigma_px


@pytest.mark.slow
def test_what_cannot_be_cross_validated_is_not_written(small, capsys):
    assert calibrated(small, "--frames", "9") == 3
    told = capsys.readouterr()
    assert "too short to be cross-validated" in told.out
    text = Path("calibrated.yaml").read_text(encoding="utf-8")
    assert text == f"# as before the calibration: too short to be cross-validated\n{dump(load(Path(small)))}"


@pytest.mark.slow
def test_another_recording_has_a_say(small, tmp_path, capsys):
    assert simulate.main([small, "--out", "drive.npz", "--set", "seed=2"]) == 0
    assert calibrated(small, *FEW, "--also", "drive.npz") in (0, 3)
    assert "log likelihood gained on drive" in capsys.readouterr().out


@pytest.mark.slow
def test_only_the_first_frames_are_used_when_told(small, monkeypatch, capsys):
    seen = set()
    whole = Evaluator.run

    def watched(self, config, **options):
        seen.add((len(self.dataset.sequence), self.dataset.reference))
        return whole(self, config, **options)

    monkeypatch.setattr(Evaluator, "run", watched)
    assert calibrated(small, "--frames", "9") == 3
    # Nor is there a reference to look at.
    assert seen == {(9, None)}


@pytest.mark.slow
def test_processes_side_by_side_find_the_same(small, capsys):
    assert calibrated(small, *FEW, "--out", "one.yaml") == 0
    assert calibrate.main(["--config", small, *FEW, "--out", "two.yaml", "--processes", "2"]) == 0
    assert Path("one.yaml").read_bytes() == Path("two.yaml").read_bytes()


@pytest.mark.slow
def test_a_substitute_for_a_missing_recording_is_reported(capsys):
    short = ["--set", "data.simulation.frames=24", "--set", "data.simulation.tracks_in_view=15"]
    # Whether so short a drive is predicted better by what it says is not the question here.
    assert calibrated(DS3, *short, *FEW) in (0, 3)
    assert capsys.readouterr().out.startswith("SIMULATED: synthetic substitute for 03.npz")


def complaint(capsys):
    """The one line that an answer to bad input is."""
    said = capsys.readouterr()
    assert said.err.startswith("vislam: ")
    assert said.err.count("\n") == 1
    return said.err


def test_a_missing_config_gets_one_line_and_2(tmp_path, capsys):
    assert calibrated("nowhere.yaml") == 2
    assert "nowhere.yaml: cannot be read" in complaint(capsys)
    assert not list(tmp_path.iterdir())


def test_missing_data_gets_one_line_and_2(tmp_path, capsys):
    assert calibrated(DS3, "--no-substitute") == 2
    assert "03.npz: not found in" in complaint(capsys)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (["--set", "noise.pixel_sigma_px=-1"], "noise.pixel_sigma_px"),
        (["--set", "noise.pixel"], "expected KEY=VALUE"),
        (["--frames", "0"], "--frames must be at least 2, got 0"),
        (["--frames", "-3"], "--frames must be at least 2, got -3"),
        (["--processes", "0"], "--processes must be at least 1, got 0"),
        (["--processes", "-1"], "--processes must be at least 1, got -1"),
        (["--set", "data.simulation.loss_probability=1.0"], "no stereo observation is left"),
    ],
    ids=["range", "no value", "no frames", "fewer", "no processes", "fewer processes", "nothing seen"],
)
def test_bad_input_gets_one_line_and_2(small, more, message, capsys):
    assert calibrated(small, *more) == 2
    assert message in complaint(capsys)
    assert not Path("calibrated.yaml").exists()


def unfinished(path):
    """The round that an unfinished config names; it is a whole config all the same."""
    first, _, rest = path.read_text(encoding="utf-8").partition("\n")
    assert rest == dump(load(path))
    return first.removeprefix("# calibration unfinished: ")


@pytest.mark.slow
def test_the_best_so_far_is_written_after_each_round(small, monkeypatch, capsys):
    seen = []
    write = Output.keep

    def watched(self, config, where):
        write(self, config, where)
        seen.append((unfinished(self.path), where, load(self.path).noise.pixel_sigma_px))

    monkeypatch.setattr(Output, "keep", watched)
    assert calibrated(small) == 0
    shown = capsys.readouterr().out
    assert len(seen) >= 3
    assert re.search(r"^it will take about \d+ (s|min): some \d+ runs of the filter of \S+ s, ", shown, re.M)
    for first, where, _ in seen:
        assert first == where
        assert re.fullmatch(r"choice [123] of at most 3, round \d+", where)
        (line,) = [line for line in shown.splitlines() if line.startswith(f"{where}: ")]
        assert re.search(r": log likelihood \S+, gained \S+; (about \d+ (s|min) left|takes longer)", line)
    # It is the best so far that is kept, not where it began, and the end is marked no more.
    assert seen[0][2] != load(Path(small)).noise.pixel_sigma_px
    assert not Path("calibrated.yaml").read_text(encoding="utf-8").startswith("#")


ENDS = {
    "diverged": (DivergedError("lost"), 1, "vislam: lost"),
    "interrupted": (Interrupted("SIGTERM"), 130, "vislam: interrupted"),
    "disk full": (DataError("disk: full"), 2, "vislam: disk: full"),
}


@pytest.mark.slow
@pytest.mark.parametrize("end", sorted(ENDS))
@pytest.mark.parametrize("rounds", [0, 2])
def test_whatever_ends_it_the_best_so_far_stays(end, rounds, small, monkeypatch, capsys):
    error, code, said = ENDS[end]
    write, before = Output.keep, []

    def fails(self, config, where):
        if len(before) == rounds:
            raise error
        write(self, config, where)
        before.append(where)

    monkeypatch.setattr(Output, "keep", fails)
    assert calibrated(small) == code
    told = capsys.readouterr()
    assert told.err.startswith(said)
    assert told.err.count("\n") == 1
    if rounds:
        assert unfinished(Path("calibrated.yaml")) == before[-1]
        assert told.out.splitlines()[-1] == f"best config so far ({before[-1]}): calibrated.yaml"
    else:
        assert not Path("calibrated.yaml").exists()


def test_a_filter_that_fails_gives_1_and_leaves_the_old_file(small, monkeypatch, capsys):
    from vislam.estimators.ekf import EkfEstimator

    def failing(self, frame):
        raise DivergedError("covariance lost, smallest variance -1")

    Path("calibrated.yaml").write_text("from before", encoding="utf-8")
    monkeypatch.setattr(EkfEstimator, "process", failing)
    assert calibrated(small) == 1
    assert "the filter did not finish" in complaint(capsys)
    assert Path("calibrated.yaml").read_text(encoding="utf-8") == "from before"
    assert {path.name for path in Path().iterdir()} == {"small.yaml", "calibrated.yaml"}
