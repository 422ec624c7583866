"""The command ``vislam``: its parts, and the configs that come along."""

import re
import tomllib
from importlib import import_module
from pathlib import Path

import pytest

from vislam.base.errors import ConfigError
from vislam.base.shipped import about, find_config, shipped_configs
from vislam.cli.main import COMMANDS, main
from vislam.comparison import config as configuration

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_version_is_that_of_the_project(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"vislam {PROJECT['project']['version']}\n"


def test_the_usage_names_each_command(capsys):
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    assert all(re.search(rf"^  {name} +\w", said, re.MULTILINE) for name in COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_answers_for_help(name, capsys):
    with pytest.raises(SystemExit) as caught:
        main([name, "--help"])
    assert caught.value.code == 0
    assert "usage:" in capsys.readouterr().out


@pytest.mark.parametrize("given", [["no"], ["--no"], ["compare.py"], [""]])
def test_what_is_no_command_is_a_line_and_2(given, capsys):
    assert main(given) == 2
    said = capsys.readouterr().err
    assert said.startswith("vislam: no command")
    assert said.count("\n") == 1


def test_without_a_command_there_is_the_usage_and_2(capsys):
    assert main([]) == 2
    assert "usage: vislam COMMAND" in capsys.readouterr().out


def test_every_shipped_config_is_listed_with_a_line_and_can_be_printed(capsys):
    assert main(["configs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    folder = ROOT / "configs"
    names = {path.relative_to(folder).with_suffix("").as_posix() for path in folder.rglob("*.yaml")}
    assert {line.split()[0] for line in lines} == names
    assert all(len(line.split(maxsplit=1)[1]) > 15 for line in lines)
    for name in names:
        assert main(["configs", name]) == 0
        assert capsys.readouterr().out == (ROOT / "configs" / f"{name}.yaml").read_text(encoding="utf-8")
    assert main(["configs", "nothing"]) == 2


@pytest.mark.parametrize("name", ["tiny", "tiny.yaml", "configs/tiny.yaml", "configs/tiny"])
def test_a_shipped_config_is_found_from_any_folder(name, elsewhere, capsys):
    import_module("vislam.cli.compare")
    assert main(["compare", name, "--dump-config"]) == 0
    said = capsys.readouterr().out
    assert main(["compare", "--config", name, "--dump-config"]) == 0
    assert capsys.readouterr().out == said
    assert "name: tiny" in said


def test_a_file_of_ones_own_goes_before_the_shipped_one(elsewhere):
    assert find_config("tiny") == shipped_configs()["tiny"]
    (elsewhere / "tiny.yaml").write_text("name: mine", encoding="utf-8")
    assert find_config("tiny") == Path("tiny.yaml")
    assert find_config("other/tiny") is None
    assert find_config("configs/battle/kitti_0001.yaml") == shipped_configs()["battle/kitti_0001"]
    assert find_config("battle/kitti_0001") == find_config("kitti_0001.yaml")
    assert find_config("nothing") is None


@pytest.mark.parametrize("name", sorted(shipped_configs()))
def test_a_copy_of_a_shipped_config_says_the_same(name, elsewhere):
    path = shipped_configs()[name]
    (elsewhere / "mine.yaml").write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    assert configuration.read(Path("mine.yaml")) == configuration.read(path)
    assert about(path)


def test_a_base_that_is_nowhere_is_a_line(elsewhere):
    (elsewhere / "mine.yaml").write_text("extends: nothing.yaml", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"nothing\.yaml: cannot be read"):
        configuration.read(Path("mine.yaml"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["compare"], "a config is required"),
        (["compare", "tinny"], "no config 'tinny' here, and none is shipped: "),
        (["compare", "tiny", "ds3"], "unrecognized arguments: ds3"),
        (["compare", "tiny", "--config", "ds3"], "a config is named twice"),
    ],
)
def test_a_config_that_is_none_is_a_line_and_2(arguments, message, elsewhere, capsys):
    with pytest.raises(SystemExit) as caught:
        main(arguments)
    assert caught.value.code == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1


def test_the_packages_are_the_folders_and_nothing_generic_is_installed():
    listed = PROJECT["tool"]["setuptools"]["packages"]
    folders = {
        ".".join(path.parent.relative_to(ROOT).parts) for path in (ROOT / "vislam").rglob("__init__.py")
    }
    assert set(listed) == folders | {"vislam.configs", "vislam_baselines"}
    assert {name.split(".")[0] for name in listed} == {"vislam", "vislam_baselines"}
    scripts = PROJECT["project"]["scripts"]
    module, _, function = scripts["vislam"].partition(":")
    assert getattr(import_module(module), function) is main
