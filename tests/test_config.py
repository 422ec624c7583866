"""Configurations that build on others."""

from pathlib import Path

import pytest

from vislam import config
from vislam.errors import ConfigError

CONFIGS = sorted((Path(__file__).parents[1] / "configs").glob("*.yaml"))
BASE = """
name: base
data: {simulation: {frames: 30, speed: 9.0}}
noise: {pixel_sigma_px: 0.7}
estimators: {ekf: {gate: false}, isam2: {}}
"""


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def test_a_config_goes_over_the_one_it_extends(tmp_path):
    write(tmp_path, "base.yaml", BASE)
    path = write(
        tmp_path,
        "own.yaml",
        "extends: base.yaml\nname: own\ndata: {simulation: {frames: 40}}\nestimators: {eks: {}}",
    )
    found = config.load(path, overrides={"noise.drift_px": 0.1})
    assert found.name == "own"
    assert (found.data.simulation.frames, found.data.simulation.speed) == (40, 9.0)
    assert (found.noise.pixel_sigma_px, found.noise.drift_px) == (0.7, 0.1)
    assert found.estimators == {"eks": {}}


LADDER = {"ekf": "the camera", "isam2": "smoothing"}


def test_a_ladder_is_replaced_whole_and_told_whole(tmp_path):
    write(tmp_path, "base.yaml", f"{BASE}ladder: {LADDER}")
    own = write(
        tmp_path,
        "own.yaml",
        "extends: base.yaml\nestimators: {eks: {}, ekf: {}}\nladder: {eks: all, ekf: less}",
    )
    found = config.load(own)
    assert list(found.ladder) == ["eks", "ekf"]
    chosen = config.with_estimators(found, {"ekf": {}, "eks": {}, "isam2": {}})
    assert chosen.ladder == found.ladder
    assert config.with_estimators(found, {"ekf": {}}).ladder == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("extends: none.yaml", "none.yaml: cannot be read"),
        ("extends: 3", "extends: expected a file name, got 3"),
        ("extends: own.yaml", "in a circle"),
    ],
)
def test_what_cannot_be_extended_gets_a_line(tmp_path, text, message):
    with pytest.raises(ConfigError, match=message):
        config.load(write(tmp_path, "own.yaml", text))


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.stem)
def test_every_shipped_config_is_one(path):
    assert config.load(path).name == path.stem
