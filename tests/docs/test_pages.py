"""README and documentation: size, links, and blocks that are what they look like; the slow tests run them."""

import ast
import re
import tomllib

import pytest
import yaml

from docs.generate_reference import parsing, write_all
from tests.docs.blocks import GENERATED, ROOT, RUN, blocks, page_id, pages
from vislam.cli.main import COMMANDS
from vislam.comparison import config
from vislam.evaluation.definitions import DEFINITIONS
from vislam.evaluation.metric import METRICS
from vislam.study.settings import StudyConfig

PAGES = pytest.mark.parametrize("page", pages(), ids=page_id)
LINK = re.compile(r"\]\(([^)#\s]+)(?:#[^)\s]*)?\)")


def test_the_readme_is_one_screen():
    text = (ROOT / "README.md").read_bytes()
    assert len(text) <= 8192
    assert 120 <= len(text.splitlines()) <= 150


def test_the_readme_s_first_two_commands_are_those_of_the_whole_check():
    shell = "".join(block.text for block in blocks(ROOT / "README.md") if block.language == "bash")
    first, second = shell.splitlines()[:2]
    assert first == "pip install . && python -m vislam.compare --config configs/ds3.yaml"
    assert second == "pip install '.[test]' && python -m pytest -n auto"


@PAGES
def test_links_lead_to_files(page):
    for link in LINK.findall(re.sub(r"```.*?```|`[^`]*`", "", page.read_text("utf-8"), flags=re.DOTALL)):
        if "://" not in link and link.rpartition("/")[2] not in GENERATED:
            assert (page.parent / link).exists(), link


@PAGES
def test_blocks_are_of_their_language(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.yaml").write_text("extends: tiny.yaml\n", encoding="utf-8")
    for block in blocks(page):
        if block.language in ("bash", "console"):
            for command in block.commands:
                _parse(command)
        elif block.language == "python":
            ast.parse(block.text)
        elif block.language == "toml":
            tomllib.loads(block.text)
        elif block.language == "yaml":
            _load(block, tmp_path / "block.yaml")


def _parse(command):
    """A command of ours is one that its own parser takes."""
    if command[:2] == ["python", "-m"] and command[2].startswith("vislam."):
        command = ["vislam", command[2].removeprefix("vislam."), *command[3:]]
    if command[0] == "vislam" and not command[1].startswith("-"):
        assert command[1] in COMMANDS, command
        parser, given = parsing(command[1], command[2:])
        parser.parse_args([word for word in given if word not in ("-h", "--help")])


def _load(block, path):
    """A config loads; any other YAML is at least that."""
    tree = yaml.safe_load(block.text)
    known = {*config.Config.__dataclass_fields__, "extends"}
    if "not run" in block.marks or not isinstance(tree, dict) or not tree.keys() <= known:
        return
    base = "" if "extends" in tree else "extends: tiny.yaml\n"
    path.write_text(base + block.text, encoding="utf-8")
    loaded = config.load(path)
    if loaded.study is not None:
        config.parse(StudyConfig, loaded.study, at="study")


@PAGES
def test_what_is_not_run_has_a_reason(page):
    for block in blocks(page):
        assert block.marks.get("not run", "some") != ""
        assert not ("not run" in block.marks and "before" in block.marks)
        if block.marks:
            assert block.language in (*RUN, "yaml"), block


def test_a_block_is_read_with_its_marks(tmp_path):
    page = tmp_path / "page.md"
    page.write_text(
        "<!-- not run: why -->\n```bash\nvislam compare tiny > out  # so\n```\n\n```python\n1\n```\n"
    )
    one, two = blocks(page)
    assert one.marks == {"not run": "why"}
    assert one.commands == [["vislam", "compare", "tiny"]]
    assert (two.language, two.text, two.marks) == ("python", "1\n", {})


def test_a_command_that_is_none_is_found():
    with pytest.raises(SystemExit):
        _parse(["vislam", "compare", "tiny", "--no-such-option"])


def test_each_metric_has_a_definition():
    assert DEFINITIONS.keys() == METRICS.keys()


def test_the_reference_names_all_commands_keys_and_metrics(tmp_path):
    write_all(tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == GENERATED
    commands = (tmp_path / "command_line.md").read_text("utf-8")
    assert all(f"## vislam {name}\n" in commands for name in COMMANDS)
    keys = (tmp_path / "config.md").read_text("utf-8")
    assert all(f"| `{name}` |" in keys for name in config.NoiseConfig.__dataclass_fields__)
    assert not re.search(r"\| +\|$", keys, re.MULTILINE), "a key without a meaning"
    metrics = (tmp_path / "metrics.md").read_text("utf-8")
    assert all(f"({key})=\n" in metrics for key in METRICS)
    assert "| `filtered.cov` | (T, 6, 6) |" in (tmp_path / "saved_runs.md").read_text("utf-8")
