"""Front ends of others: found by name or module, held to the protocol, used by the commands."""

import importlib.metadata
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from vislam.base import plugins
from vislam.base.errors import ConfigError, ContractError
from vislam.cli.main import main
from vislam.frontend import registry
from vislam.frontend.registry import choose_front_end
from vislam.frontend.settings import FrontEndConfig
from vislam.testing import check_front_end

GUIDE = Path(__file__).parents[2] / "docs" / "guides" / "your_own_front_end.md"
TOY = '''
import numpy as np
from vislam.frontend.tracks import Tracks

class Toy:
    """Stares at one pixel."""

    def __init__(self, recording):
        self.pair = recording.pair

    def process(self, left, right, *, stamp):
        here = np.array([[100.0, 90.0]])
        return CHANGED
'''
SEEN = "Tracks.seen(self.pair, np.array([0]), here, here - [20.0, 0.0])"


@pytest.fixture
def beside(tmp_path, monkeypatch):
    """Writes a module into the current folder."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    made = []

    def write(name, text):
        (tmp_path / f"{name}.py").write_text(text)
        made.append(name)
        return tmp_path

    yield write
    for name in made:
        sys.modules.pop(name, None)


def guide_blocks():
    return re.findall(r"^```python\n(.*?)^```", GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)


def test_the_guide_s_front_end_follows_points(beside, drive_folder, capsys):
    module, test = guide_blocks()
    beside("my_tracks", module)
    beside("test_my_tracks", test)
    importlib.import_module("test_my_tracks").test_mine()
    command = ["track", str(drive_folder), "-o", "a.npz", "--front-end", "my_tracks:Mine"]
    assert main([*command, "--set", "corners=60", "--set", "fewest_observations=2"]) == 0
    assert "8 frames" in capsys.readouterr().out
    assert main([*command, "--set", "corner=60"]) == 2
    assert "--set.corner: unknown key; known are corners" in capsys.readouterr().err


def test_ours_keeps_its_own_protocol():
    tracked = check_front_end("klt", {"features": 80, "window_px": 15})
    assert tracked.figures["in_view_median"] >= 50


def test_an_installed_one_is_found_by_name_and_ours_keeps_its_name(monkeypatch, beside):
    beside("toy_tracks", TOY.replace("CHANGED", SEEN))
    own = importlib.metadata.EntryPoint("toy", "toy_tracks:Toy", registry.GROUP)
    stolen = importlib.metadata.EntryPoint("klt", "toy_tracks:Toy", registry.GROUP)
    monkeypatch.setattr(plugins, "entry_points", lambda group: [own, stolen])
    plugins._of.cache_clear()
    try:
        assert "toy_tracks:Toy" in choose_front_end("toy").origin
        assert isinstance(choose_front_end("klt").reading, FrontEndConfig)
    finally:
        plugins._of.cache_clear()


def test_another_source_is_another_origin(beside):
    beside("toy_tracks", TOY.replace("CHANGED", SEEN))
    one = choose_front_end("toy_tracks:Toy").origin
    beside("toy_tracks", TOY.replace("CHANGED", "None"))
    assert choose_front_end("toy_tracks:Toy").origin != one


def test_one_that_follows_no_point_is_found_out(beside):
    beside("toy_tracks", TOY.replace("CHANGED", SEEN))
    with pytest.raises(ContractError, match="tracks must follow points of the world within 2 px"):
        check_front_end("toy_tracks:Toy")


@pytest.mark.parametrize(
    ("returned", "said"),
    [
        ("here", r"pair 0: process must return Tracks or None, got ndarray"),
        (SEEN.replace("[0]", "[-1]"), r"pair 0: track must be ids >= 0, each once"),
        (SEEN.replace("[0]", "[0.5]"), r"pair 0: track must be whole numbers"),
        ("Tracks(np.array([0]), here, here, here, here)", r"pair 0: pixels must be \(1, 4\), got \(1, 2\)"),
        (
            "Tracks(np.array([0]), here, here * np.nan, np.ones((1, 4)), here)",
            r"pair 0: right must be finite numbers",
        ),
    ],
)
def test_what_breaks_the_protocol_is_one_line(beside, drive_folder, returned, said, capsys):
    beside("toy_tracks", TOY.replace("CHANGED", returned))
    with pytest.raises(ContractError, match=said):
        check_front_end("toy_tracks:Toy")
    assert main(["track", str(drive_folder), "-o", "a.npz", "--front-end", "toy_tracks:Toy"]) == 2
    error = capsys.readouterr().err
    assert re.search(said, error)
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("name", "given", "said"),
    [
        ("nobody", {}, r"no such front end; installed are klt"),
        ("no_module:Mine", {}, r"no_module:Mine: cannot be imported"),
        ("toy_tracks:Nobody", {}, r"toy_tracks:Nobody: cannot be imported"),
        ("toy_tracks:np", {}, r"must be a function or class"),
        ("toy_tracks:Toy", {"x": 1}, r"takes no settings of its own, got x"),
        ("toy_tracks:Toy", {"fewest_observations": 0}, r"--set.fewest_observations"),
        ("klt", {"feature": 1}, r"--set.feature: unknown key"),
    ],
)
def test_what_cannot_be_chosen_is_one_line(beside, name, given, said):
    beside("toy_tracks", TOY.replace("CHANGED", SEEN))
    with pytest.raises(ConfigError, match=said):
        choose_front_end(name, given)


def test_tracks_without_a_ray_are_left_out():
    from tests.frontend.studio import pair
    from vislam.frontend.tracks import Tracks
    from vislam.models.camera import Lens

    here = np.array([[100.0, 90.0], [1e6, 1e6]])
    assert len(Tracks.seen(pair(Lens.KANNALA_BRANDT), np.array([4, 5]), here, here)) == 1
