"""Names and notes with letters that mean something to Rich, Matplotlib, HTML, XML and the terminal."""

import json
import re
import subprocess
import sys
from html import escape
from pathlib import Path
from xml.etree import ElementTree as Xml

import pytest
import yaml

from vislam import compare, evaluate, inspect
from vislam.base.files import folder_name
from vislam.base.settings import LONGEST_NAME
from vislam.cli.console import Terminal

ROOT = Path(__file__).parents[2]
DRIVE = {"frames": 12, "tracks_in_view": 15}
EVIL = {
    "markup": "kitti [/07] [bold] [link=file:///x]",
    "mathematics": r"RTK \$10k ($\sigma$ 2 cm, $\pm_{x$)",
    "one dollar": "5 $ [m]",
    "tags": "<script>alert(1)</script> & <b>",
    "terminal": "a\x1b[31mred\x07\x9b2J\rb",
    "lines": "a\nFAULT: b\u2028c",
    "braces": "{task.description} {0} %s",
    "letters": "näme \U0001f697\u202e",
    "leads out": "../../../tmp/x",
    "hidden": ".",
    "underscore": "_hidden",
    "option": "--help",
    "long": "x" * LONGEST_NAME,
}


@pytest.fixture(autouse=True)
def here(monkeypatch, tmp_path):
    monkeypatch.setenv("VISLAM_DATA", str(tmp_path))
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def truth():
    """Truth of the drive, as a reference to be called as one likes."""
    tree = {"name": "t", "data": {"simulation": DRIVE}}
    Path("t.yaml").write_text(yaml.safe_dump(tree))
    from vislam import simulate

    assert simulate.main(["--config", "t.yaml", "--out", "drive.npz"]) == 0


def config(name, *, reference="r", limits="none", chain=None):
    given = {"file": "drive_truth.tum", "format": "tum", "name": reference, "limits": limits}
    tree = {
        "name": name,
        "data": {"file": "drive.npz", "reference": given},
        "estimators": {"dead_reckoning": {}, "_mine": {"estimator": "dead_reckoning"}},
        "ablation_chain": chain or {},
    }
    Path("c.yaml").write_text(yaml.safe_dump(tree))
    return ["--config", "c.yaml", "--out", "out", "--junit", "j.xml"]


def assert_plain(said):
    assert "\x1b" not in said
    assert all(line.isprintable() for line in said.splitlines())


@pytest.mark.parametrize("case", sorted(EVIL))
def test_a_name_of_any_letters_is_shown_as_it_is(case, truth, capsys):
    name = EVIL[case]
    capsys.readouterr()
    assert compare.main([*config(name, reference=name, limits=name), "--no-report"]) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert_plain(said.out)
    if name.isprintable() and case != "long":
        assert f"vislam {name}: drive" in said.out
    (folder,) = Path("out").iterdir()
    assert folder.name.startswith(f"{folder_name(name)}-")
    assert json.loads((folder / "metrics.json").read_text())["name"] == name
    suite = Xml.parse("j.xml").getroot()[0]
    assert suite.attrib["name"] == re.sub("[^\\t\\n\\r\\x20-\\U0010ffff]", "?", name)
    assert evaluate.main([str(folder), "--no-report"]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("case", ["markup", "mathematics", "tags", "terminal", "underscore"])
def test_a_report_shows_any_letters_as_they_are(case, truth):
    name = EVIL[case]
    chain = {"dead_reckoning": name, "_mine": name}
    assert compare.main(config(name, reference=name, limits=name, chain=chain)) == 0
    (page,) = Path("out").glob("*/report.html")
    text = page.read_text(encoding="utf-8")
    assert "\x1b" not in text
    assert "<script>alert" not in text
    if name.isprintable():
        assert escape(name, quote=False) in text.replace("&#39;", "'")
    assert {"top_view.svg", "ablation_chain.svg"} <= {
        path.name for path in (page.parent / "figures").iterdir()
    }


@pytest.mark.parametrize("case", ["markup", "mathematics", "terminal"])
def test_an_inspection_shows_the_name_of_a_file_as_it_is(case, truth, capsys):
    name = EVIL[case].replace("/", "|")
    Path("drive.npz").rename(f"{name}.npz")
    capsys.readouterr()
    assert inspect.main(["--file", f"{name}.npz", "--write-config", "w.yaml"]) == 0
    assert_plain(capsys.readouterr().out)
    assert Path("inspection/tracks.png").is_file()
    assert yaml.safe_load(Path("w.yaml").read_text())["name"] == name


@pytest.mark.parametrize("case", sorted(EVIL))
def test_a_terminal_is_not_obeyed(case, capsys):
    terminal = Terminal()
    terminal.note(EVIL[case])
    terminal.rows([EVIL[case]], [[EVIL[case]]], title=EVIL[case])
    with terminal.bar(EVIL[case], 3) as bar:
        bar.done(2)
    assert_plain(capsys.readouterr().out)


BAR = """
import sys
from html import escape
from vislam.cli.console import Terminal
with Terminal().bar(sys.argv[1], 3) as bar:
    bar.done(2)
    bar._drawn.refresh()
"""


@pytest.mark.parametrize("case", ["markup", "terminal", "braces"])
def test_a_bar_shows_its_title_as_it_is(case):
    done = subprocess.run(
        [sys.executable, "-c", BAR, EVIL[case]],
        cwd=ROOT,
        capture_output=True,
        check=False,
        env={"FORCE_COLOR": "1", "COLUMNS": "200", "PYTHONPATH": str(ROOT)},
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert b"\x07" not in done.stdout
    assert b"\x1b[31mred" not in done.stdout
    shown = EVIL[case].split("\x1b")[0]
    assert shown.encode() in done.stdout
