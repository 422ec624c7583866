"""``vislam track`` and ``vislam compare --data``: what they write, and how they answer bad input."""

import json
import sys

import numpy as np
import pytest

from vislam.cli.main import main

pytest.importorskip("cv2")

SET = ["--set", "features=60", "--set", "window_px=15"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    from tests.frontend.studio import rendered, write_asl

    return write_asl(tmp_path_factory.mktemp("run"), rendered(5))


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)


def test_tracks_are_written_and_found_again(folder, tmp_path, capsys):
    assert main(["track", str(folder), "-o", "a.npz", *SET]) == 0
    first = capsys.readouterr().out
    assert "5 frames" in first
    assert "frames/s" in first
    assert "NO VELOCITY was recorded" in first
    with np.load("a.npz") as file:
        assert {"stamp", "frame", "track", "pixels", "K", "baseline", "imu_T_cam"} <= set(file)
        assert file["pixels"].shape == (len(file["frame"]), 4)
        assert file["angular_velocity"].shape == file["linear_velocity"].shape
        rows = len(file["frame"])
    with np.load("a_quality.npz") as file:
        assert file["forward_backward_px"].shape == (rows, 2)
        assert file["life"].min() >= 4
    summary = json.loads((tmp_path / "a_front_end.json").read_text())
    assert summary["settings"]["features"] == 60
    assert main(["track", str(folder), "-o", "b.npz", *SET]) == 0
    assert "from the cache" in capsys.readouterr().out
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert main(["track", str(folder), "-o", "c.npz", *SET, "--set", "features=50"]) == 0
    assert "from the cache" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["none", "-o", "a.npz"], "none: no such folder"),
        (["FOLDER", "-o", "a.txt"], "--out must name a .npz file, got a.txt"),
        (["FOLDER", "-o", "a.npz", "--set", "featurs=3"], "--set.featurs: unknown key; known are"),
        (["FOLDER", "-o", "a.npz", "--set", "features=3"], "--set.features"),
    ],
)
def test_bad_input_is_one_line(folder, arguments, said, capsys):
    arguments = [str(folder) if item == "FOLDER" else item for item in arguments]
    assert main(["track", *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_without_opencv_the_remedy_is_named(folder, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "cv2", None)
    assert main(["track", str(folder), "-o", "a.npz"]) == 2
    assert "pip install 'vislam[images]'" in capsys.readouterr().err


def test_compare_takes_a_config_or_data(capsys):
    for arguments in (["tiny", "--data", "x"], []):
        with pytest.raises(SystemExit) as caught:
            main(["compare", *arguments])
        assert caught.value.code == 2
        assert "a config is required, or --data with a recording" in capsys.readouterr().err
    assert main(["compare", "--data", "x"]) == 2
    assert "x: not found; name a folder of stereo images" in capsys.readouterr().err
