"""Every command and code block of README and documentation runs as it stands, but those that are marked."""

import os
import subprocess
import sys

import pytest

from tests.docs.blocks import ROOT, RUN, blocks, page_id, pages

pytestmark = pytest.mark.slow


def _runs(block):
    return block.language in RUN and "not run" not in block.marks and "file" not in block.marks


@pytest.fixture
def surroundings(tmp_path):
    """An environment in which ``vislam`` and ``python`` are those of the tests."""
    commands = tmp_path / "commands"
    commands.mkdir()
    for name, called in (("vislam", "-m vislam"), ("python", "")):
        script = commands / name
        script.write_text(f'#!/bin/sh\nexec "{sys.executable}" {called} "$@"\n', encoding="utf-8")
        script.chmod(0o755)
    path = f"{commands}{os.pathsep}{os.environ['PATH']}"
    modules = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    return {**os.environ, "PATH": path, "PYTHONPATH": modules, "MPLBACKEND": "agg"}


@pytest.mark.parametrize("page", [page for page in pages() if any(map(_runs, blocks(page)))], ids=page_id)
def test_a_page_runs(page, tmp_path, surroundings):
    folder = tmp_path / "page"
    folder.mkdir()
    for block in blocks(page):
        if "file" in block.marks:
            (folder / block.marks["file"]).write_text(block.text, encoding="utf-8")
        if _runs(block):
            _run(["bash", "-ec", block.marks.get("before", "true")], folder, surroundings)
            _run(_called(block), folder, surroundings)


def _called(block):
    if block.language == "python":
        return [sys.executable, "-c", block.text]
    if block.language == "bash":
        return ["bash", "-eo", "pipefail", "-c", block.text]
    lines = [line.removeprefix("$ ") for line in block.text.splitlines() if line.startswith("$ ")]
    return ["bash", "-eo", "pipefail", "-c", "\n".join(lines)]


def _run(command, folder, surroundings):
    done = subprocess.run(command, cwd=folder, env=surroundings, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command[-1]}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"


def test_the_notebook_runs(tmp_path, surroundings):
    pytest.importorskip("nbclient", reason="needs the extra docs")
    code = "from docs.execute_notebook import *; [execute(path) for path in NOTEBOOKS.glob('*.ipynb')]"
    _run([sys.executable, "-c", code], tmp_path, surroundings)
