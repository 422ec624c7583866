"""check_estimator: sound estimators pass, each fault is named; the guide to plugins runs as it stands."""

import importlib
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from vislam.base.errors import ConfigError, ContractError
from vislam.cli.main import main
from vislam.core.estimator import find
from vislam.core.step import Final, Step
from vislam.testing import check_estimator

ROOT = Path(__file__).parents[1]
BUILT_IN = (
    *("ekf", "ekf_iterated", "ekf_fej", "ekf_invariant", "eks", "msckf"),
    *("isam2", "isam2_norelin", "fixed_lag"),
)
BLOCK = re.compile(r"^```(python|yaml)\n(.*?)^```", re.MULTILINE | re.DOTALL)


@pytest.fixture
def walked(tmp_path, monkeypatch):
    """The files of the guide, in an empty folder."""
    blocks = BLOCK.findall((ROOT / "docs" / "start" / "your_own_estimator.md").read_text(encoding="utf-8"))
    texts = [text for _, text in blocks]
    assert [kind for kind, _ in blocks] == ["python", "yaml", "python"]
    for name, text in zip(("my_module.py", "mine.yaml", "test_mine.py"), texts, strict=True):
        (tmp_path / name).write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path, str(tmp_path)])
    yield tmp_path
    for name in ("my_module", "test_mine"):
        sys.modules.pop(name, None)


def test_the_guide_runs_as_it_stands(walked, capsys):
    assert main(["compare", "mine.yaml", "--no-report"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"┃ +mine ┃", said)
    importlib.import_module("test_mine").test_mine()
    assert len((walked / "my_module.py").read_text().splitlines()) < 40


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (
            '{estimator: "my_module:Mine", scaling: 1}',
            "estimators.mine.scaling: unknown key; known are scale",
        ),
        ('{estimator: "my_module:Mine", scale: x}', "estimators.mine.scale: "),
    ],
)
def test_its_options_are_parsed(section, message, walked, capsys):
    assert main(["compare", "mine.yaml", "--no-report", "--set", f"estimators.mine={section}"]) == 2
    assert message in capsys.readouterr().err


def test_changed_code_of_a_module_is_another_result(walked, capsys):
    for text in ("1.0", "1.0", "2.0"):
        source = (walked / "my_module.py").read_text().replace("scale: float = 1.0", f"scale: float = {text}")
        (walked / "my_module.py").write_text(source)
        assert main(["compare", "mine.yaml", "--no-report"]) == 0
    assert len(list((walked / "results").iterdir())) == 2


@pytest.mark.parametrize("name", ["my_module:nothing", "no_module:build"])
def test_what_cannot_be_loaded_ends_its_run_alone(name, walked, capsys):
    section = f'estimators.mine={{estimator: "{name}"}}'
    assert main(["compare", "mine.yaml", "--no-report", "--set", section]) == 1
    assert "mine is incomplete: cannot be built" in capsys.readouterr().out


@pytest.mark.parametrize("name", BUILT_IN)
def test_ours_keep_the_contract(name):
    assert check_estimator(name).complete


class Sound:
    def __init__(self, problem):
        self.pose = np.eye(4)

    def process(self, frame):
        return Step(self.pose, used=frame.stereo.usable)

    def finalize(self):
        return Final()


def test_one_without_options_refuses_them():
    assert check_estimator(lambda problem, options: Sound(problem)).complete
    with pytest.raises(ConfigError, match="it takes no options, got gate"):
        find("tests.test_testing:Sound")(None, {"gate": 1})


class Random(Sound):
    def process(self, frame):
        pose = np.eye(4)
        pose[0, 3] = np.random.default_rng().normal()
        return Step(pose)


class Stubborn(Sound):
    def process(self, frame):
        return Step(self.pose, used=np.ones(len(frame.stereo), bool))


class Misshapen(Sound):
    def process(self, frame):
        return Step(self.pose, used=np.ones(len(frame.stereo) + (frame.k == 3), bool))


class Skew(Sound):
    def process(self, frame):
        cov = np.eye(6)
        cov[0, 1] = 0.5
        return Step(self.pose, pose_cov=cov)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        (Random, "frame 0: two runs over the same drive differ"),
        (Stubborn, r"fused \d+ observations that are not usable"),
        (Misshapen, r"frame 3: used must be \(\d+,\), got \(\d+,\)"),
        (Skew, "frame 0: pose_cov must be symmetric"),
    ],
)
def test_each_fault_is_named(kind, message):
    with pytest.raises(ContractError, match=message):
        check_estimator(lambda problem, options: kind(problem))


def test_one_that_knows_the_end_is_found():
    lengths = iter((16, 16, 8, 16))

    class Knowing(Sound):
        def __init__(self, problem):
            self.pose = np.eye(4)
            self.pose[0, 3] = next(lengths)

    with pytest.raises(ContractError, match="frame 0: later frames change what it says"):
        check_estimator(lambda problem, options: Knowing(problem))
