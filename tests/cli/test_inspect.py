"""The inspection as a command: verdicts, files, the config it writes, exit codes."""

import json
import os
from dataclasses import replace

import pytest
import yaml

from tests.cli.test_compare import course_file
from tests.data.test_plausibility import drive, with_stamps
from vislam import compare
from vislam.comparison import config as configuration
from vislam.datasets.course_export import write_course_npz
from vislam.inspect import main
from vislam.inspection import page as inspection_page
from vislam.inspection.written import annotated

SPOILT = """
name: spoilt
data:
  simulation: {frames: 120, tracks_in_view: 50, duplication_probability: 0.1, extrinsic_axes: [x, -y, -z]}
  repair: {duplicated_tracks: false}
noise: {twist_density: [0.001, 0.001, 0.001, 0.006, 0.02, 0.02]}
"""


def written(path, text):
    path.write_text(text)
    return str(path)


@pytest.mark.slow
def test_it_says_writes_and_proposes(tmp_path, capsys):
    config, out, proposed = written(tmp_path / "c.yaml", SPOILT), tmp_path / "out", tmp_path / "new.yaml"
    assert main(["--config", config, "--out", str(out), "--write-config", str(proposed)]) == 0
    said = capsys.readouterr().out
    assert "SIMULATED" in said
    assert "FAULT   duplicated tracks" in said
    assert "FAULT   axes and extrinsic" in said
    document = json.loads((out / "inspection.json").read_text())
    assert document["synthetic"] is True
    assert document["proposal"]["data.repair.duplicated_tracks"] is True
    figures = ["checks.png", "motion.png", "shared.png", "tracks.png"]
    assert sorted(path.name for path in out.glob("*.png")) == figures
    repaired = configuration.load(proposed).data.repair
    assert repaired.axes is not None
    assert repaired.axes.body == ("x", "-y", "-z")
    assert repaired.duplicated_tracks is not None


@pytest.mark.slow
def test_what_it_writes_has_no_such_fault_left(tmp_path, capsys):
    config, proposed = written(tmp_path / "c.yaml", SPOILT), tmp_path / "new.yaml"
    main(["--config", config, "--out", str(tmp_path / "out"), "--write-config", str(proposed)])
    capsys.readouterr()
    assert main(["--config", str(proposed), "--out", str(tmp_path / "out"), "--strict"]) in (0, 3)
    said = capsys.readouterr().out
    assert "FAULT   duplicated tracks" not in said
    assert "FAULT   axes and extrinsic" not in said


@pytest.mark.slow
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
        ([], "one of --config, --file and --data"),
        (["--file", str(tmp_path / "none.npz")], "no such file"),
        (["--file", str(tmp_path / "text.npz")], "not a whole npz archive"),
        (["--config", str(tmp_path / "none.yaml")], "cannot be read"),
        (["--data", str(tmp_path / "none")], "not found"),
        (["--data", str(tmp_path / "text.npz")], "expected a folder or bag of stereo images"),
    ):
        assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
        said = capsys.readouterr().err
        assert message in said
        assert said.startswith("vislam: ")
        assert len(said.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.fixture
def nowhere(monkeypatch, tmp_path):
    """A current folder with nothing in it, and no $VISLAM_DATA."""
    monkeypatch.delenv("VISLAM_DATA", raising=False)
    (tmp_path / "nowhere").mkdir()
    monkeypatch.chdir(tmp_path / "nowhere")
    return tmp_path


def runs(config, out, *more):
    """Whether a written config runs as it is."""
    assert (
        compare.main(
            ["--config", str(config), "--out", str(out), "--estimators", "ekf", "--no-report", *more]
        )
        == 0
    )
    (folder,) = out.iterdir()
    return folder.name


@pytest.mark.slow
@pytest.mark.parametrize("where", ["beside", "elsewhere"])
def test_a_written_config_runs_as_written_from_any_folder(nowhere, where, capsys):
    write_course_npz(nowhere / "recordings" / "drive.npz", drive(frames=30))
    target = nowhere / ("recordings" if where == "beside" else "configs") / "mine.yaml"
    file = nowhere / "recordings" / "drive.npz"
    arguments = ["--out", str(nowhere / "inspection"), "--write-config", str(target)]
    assert main(["--file", str(file), *arguments]) == 0
    written = configuration.load(target)
    assert written.data.file == ("drive.npz" if where == "beside" else str(file))
    runs(target, nowhere / "out")
    capsys.readouterr()


@pytest.mark.slow
def test_a_written_config_keeps_what_its_own_config_names(nowhere):
    """Recording, reference and what was set by hand, though the new config lies in another folder."""
    sequence = drive(frames=30)
    write_course_npz(nowhere / "here" / "drive.npz", sequence)
    lines = [f"{stamp:.6f} 0 0 0 0 0 0 1" for stamp in sequence.stamp]
    (nowhere / "here" / "truth.tum").write_text("\n".join(lines))
    (nowhere / "here" / "c.yaml").write_text(
        "name: c\ndata: {file: drive.npz, reference: {file: truth.tum, format: tum, name: t, limits: none}}\n"
        "noise: {pixel_sigma_px: 0.77}\n"
    )
    target = nowhere / "new.yaml"
    config = nowhere / "here" / "c.yaml"
    assert main(["--config", str(config), "--out", str(nowhere / "i"), "--write-config", str(target)]) == 0
    written = configuration.load(target)
    assert written.data.file == "here/drive.npz"
    assert written.data.reference.file == "here/truth.tum"
    assert written.noise.pixel_sigma_px == 0.77
    assert written.noise.twist_density != configuration.NoiseConfig().twist_density
    runs(target, nowhere / "out")


@pytest.mark.parametrize("how", ["--data-dir", "$VISLAM_DATA", "here", "data"])
def test_a_bare_file_is_found_where_a_config_would_find_it(nowhere, how, monkeypatch):
    monkeypatch.setattr(inspection_page, "drawings", lambda result, *, title: {})
    folder = {"here": nowhere / "nowhere", "data": nowhere / "nowhere" / "data"}.get(how, nowhere / "far")
    write_course_npz(folder / "drive.npz", drive(frames=8))
    if how == "$VISLAM_DATA":
        monkeypatch.setenv("VISLAM_DATA", str(folder))
    more = ["--data-dir", str(folder)] if how == "--data-dir" else []
    target = nowhere / "mine.yaml"
    assert (
        main(["--file", "drive.npz", "--out", str(nowhere / "i"), "--write-config", str(target), *more]) == 0
    )
    monkeypatch.delenv("VISLAM_DATA", raising=False)
    monkeypatch.chdir(nowhere)
    assert os.path.samefile(nowhere / configuration.load(target).data.file, folder / "drive.npz")
    runs(target, nowhere / "out")


def test_the_result_does_not_depend_on_where_the_config_lies(nowhere):
    for place in ("one", "two"):
        write_course_npz(nowhere / place / "drive.npz", drive(frames=8))
        (nowhere / place / "c.yaml").write_text("name: c\ndata: {file: drive.npz}\n")
    names = {runs(nowhere / place / "c.yaml", nowhere / place / "out") for place in ("one", "two")}
    assert len(names) == 1


@pytest.mark.slow
def test_the_order_of_the_folders(nowhere, monkeypatch):
    """--data-dir, the config's own folder, $VISLAM_DATA, the current folder, data/."""
    places = {
        "option": nowhere / "option",
        "config": nowhere / "config",
        "variable": nowhere / "variable",
        "current": nowhere / "nowhere",
        "data": nowhere / "nowhere" / "data",
    }
    monkeypatch.setenv("VISLAM_DATA", str(places["variable"]))
    for frames, folder in enumerate(places.values(), start=6):
        write_course_npz(folder / "drive.npz", drive(frames=frames))
    config = places["config"] / "c.yaml"
    config.write_text("name: c\ndata: {file: drive.npz}\n")
    found = []
    for folder in places.values():
        out = nowhere / "out" / folder.name
        arguments = ["--config", str(config), "--out", str(out), "--data-dir", str(places["option"])]
        assert main(arguments) == 0
        findings = json.loads((out / "inspection.json").read_text())["findings"]
        found.append(next(item["text"].split()[0] for item in findings if item["check"] == "stamps"))
        (folder / "drive.npz").unlink()
    assert found == ["6", "7", "8", "9", "10"]


def test_what_could_not_be_told_is_marked_in_the_config(nowhere):
    write_course_npz(nowhere / "few.npz", drive(frames=30, tracks_in_view=2))
    target = nowhere / "few.yaml"
    assert (
        main(["--file", str(nowhere / "few.npz"), "--out", str(nowhere / "i"), "--write-config", str(target)])
        == 0
    )
    lines = target.read_text().splitlines()
    for key in (
        "clock:",
        "axes:",
        "navigation_frame_velocity:",
        "pixel_sigma_px:",
        "bias_sigma:",
        "matching_bias_px:",
    ):
        # Repairs come first; an error that tracks share may have the name of one.
        at = next(k for k, line in enumerate(lines) if line.strip().startswith(key))
        assert lines[at - 1].strip().startswith("# unknown: "), key
    assert configuration.load(target).data.repair.navigation_frame_velocity is not None


@pytest.mark.slow
def test_stamps_in_milliseconds_are_a_fault_with_a_guess(nowhere, capsys):
    write_course_npz(nowhere / "late.npz", with_stamps(drive(frames=25), 1e3))
    target = nowhere / "late.yaml"
    arguments = [
        "--file",
        str(nowhere / "late.npz"),
        "--out",
        str(nowhere / "i"),
        "--write-config",
        str(target),
    ]
    assert main([*arguments, "--strict"]) == 3
    said = capsys.readouterr().out
    assert "FAULT   stamps: a frame every 104.6 s" in said
    assert "look like milliseconds" in said
    assert "# unknown: compare rejects this recording until its stamps are mended" in target.read_text()


def test_annotated_yaml_is_the_same_yaml():
    lines = ["a: 1", "b:", "  c:", "  - 1", "  - 2", "  d:", "    e: null", "'f': {}", "g: x"]
    marks = {
        "a": "one",
        "b.c": "two\nlines \x07 of it",
        "b.d.e.missing": "three",
        "none": "four",
        "g": "g" * 999,
    }
    text = "\n".join(annotated(lines, marks))
    assert yaml.safe_load(text) == yaml.safe_load("\n".join(lines))
    assert "# one\na: 1" in text
    assert "  # two lines \\x07 of it\n  c:" in text
    assert "    # b.d.e.missing: three\n    e: null" in text
    assert max(len(line) for line in text.splitlines()) < 500


def test_swapped_cameras_are_told_and_nothing_is_proposed(nowhere, capsys):
    sequence = drive(frames=12)
    write_course_npz(nowhere / "s.npz", replace(sequence, pixels=sequence.pixels[:, [2, 3, 0, 1]]))
    assert main(["--file", str(nowhere / "s.npz"), "--out", str(nowhere / "i")]) == 0
    said = capsys.readouterr().out
    assert "FAULT   observations" in said
    assert "left and right are swapped" in said
    document = json.loads((nowhere / "i" / "inspection.json").read_text())
    assert not [path for path in document["proposal"] if path.startswith("data.repair")]
