"""The inspection as a command: verdicts, files, the config it writes, exit codes."""

import json

import pytest
import yaml

from tests.cli.test_compare import course_file
from vislam import config as configuration
from vislam.inspect import main

SPOILT = """
name: spoilt
data:
  simulation: {frames: 120, tracks_in_view: 50, stale_probability: 0.1, extrinsic_axes: [x, -y, -z]}
  repair: {stale_tracks: false}
noise: {twist_density: [0.001, 0.001, 0.001, 0.006, 0.02, 0.02]}
"""


def written(path, text):
    path.write_text(text)
    return str(path)


def test_it_says_writes_and_proposes(tmp_path, capsys):
    config, out, proposed = written(tmp_path / "c.yaml", SPOILT), tmp_path / "out", tmp_path / "new.yaml"
    assert main(["--config", config, "--out", str(out), "--write-config", str(proposed)]) == 0
    said = capsys.readouterr().out
    assert "SIMULATED" in said
    assert "FAULT   stale tracks" in said
    assert "FAULT   axes and extrinsic" in said
    document = json.loads((out / "inspection.json").read_text())
    assert document["stand_in"] is True
    assert document["proposal"]["data.repair.stale_tracks"] is True
    assert sorted(path.name for path in out.glob("*.png")) == ["checks.png", "motion.png", "tracks.png"]
    repaired = configuration.load(proposed).data.repair
    assert repaired.axes is not None
    assert repaired.axes.body == ("x", "-y", "-z")
    assert repaired.stale_tracks is not None


@pytest.mark.slow
def test_what_it_writes_has_no_such_fault_left(tmp_path, capsys):
    config, proposed = written(tmp_path / "c.yaml", SPOILT), tmp_path / "new.yaml"
    main(["--config", config, "--out", str(tmp_path / "out"), "--write-config", str(proposed)])
    capsys.readouterr()
    assert main(["--config", str(proposed), "--out", str(tmp_path / "out"), "--strict"]) in (0, 3)
    said = capsys.readouterr().out
    assert "FAULT   stale tracks" not in said
    assert "FAULT   axes and extrinsic" not in said


def test_strict_is_exit_code_3_where_a_fault_is(tmp_path):
    config = written(tmp_path / "c.yaml", SPOILT)
    assert main(["--config", config, "--out", str(tmp_path / "out"), "--strict"]) == 3


def test_a_bare_file_needs_no_config(tmp_path, capsys):
    course_file(tmp_path / "bare.npz")
    assert main(["--file", str(tmp_path / "bare.npz"), "--out", str(tmp_path / "out")]) == 0
    assert "nothing more can be told" in capsys.readouterr().out
    assert yaml.safe_load((tmp_path / "out" / "inspection.json").read_text())["name"] == "bare"


def test_bad_input_is_one_line_and_2(tmp_path, capsys):
    (tmp_path / "text.npz").write_text("no archive")
    for arguments, message in (
        ([], "one of --config and --file"),
        (["--file", str(tmp_path / "none.npz")], "no such file"),
        (["--file", str(tmp_path / "text.npz")], "not a whole npz archive"),
        (["--config", str(tmp_path / "none.yaml")], "cannot be read"),
    ):
        assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert message in said
        assert said.startswith("vislam: ")
        assert len(said.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()
