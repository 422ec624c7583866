"""Standard output and error that outlast whoever reads them."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from rich.console import Console

from vislam.cli.streams import lasting_streams

ROOT = Path(__file__).parents[1]


class Broken(io.StringIO):
    """Takes a few letters and then nothing."""

    def __init__(self, room, error):
        super().__init__()
        self.room, self.error = room, error

    def write(self, text):
        self.room -= len(text)
        if self.room < 0:
            raise self.error
        return super().write(text)

    def flush(self):
        if self.room < 0:
            raise self.error


@pytest.mark.parametrize("error", [BrokenPipeError(32, "x"), OSError(28, "x"), ValueError("closed file")])
@pytest.mark.parametrize("name", ["stdout", "stderr"])
def test_a_stream_that_breaks_falls_silent_for_good(monkeypatch, name, error):
    broken = Broken(8, error)
    monkeypatch.setattr(sys, name, broken)
    with lasting_streams():
        for text in ("one\n", "two\n", "three\n", "4\n"):
            print(text, file=getattr(sys, name), end="", flush=True)
        broken.room = 100
        print("five", file=getattr(sys, name))
    assert getattr(sys, name) is broken
    assert broken.getvalue() == "one\ntwo\n"


def test_a_console_does_not_end_the_program(monkeypatch):
    monkeypatch.setattr(sys, "stdout", Broken(0, BrokenPipeError(32, "x")))
    with lasting_streams():
        # Rich would exit with 1.
        Console().print("text")


def test_what_is_written_in_the_end_is_tried_too(monkeypatch):
    broken = Broken(100, OSError(28, "x"))
    monkeypatch.setattr(sys, "stdout", broken)
    with lasting_streams():
        print("buffered", end="")
        broken.room = -1


def test_letters_that_the_encoding_lacks_become_escapes(monkeypatch):
    content = io.BytesIO()
    monkeypatch.setattr(sys, "stdout", io.TextIOWrapper(content, encoding="ascii"))
    with lasting_streams():
        print("rad², \ud800")
    assert content.getvalue() == b"rad\\xb2, \\ud800\n"


def test_standard_error_has_no_escape_sequences(capsys):
    with lasting_streams():
        print("a\x1b[31mb\x07\nc\r\td", file=sys.stderr)
        print("a\x1b[31mb")
    said = capsys.readouterr()
    assert said.err == "a\\x1b[31mb\\x07\nc\\r\\td\n"
    assert said.out == "a\x1b[31mb\n"


def test_a_closed_stream_is_none(monkeypatch):
    monkeypatch.setattr(sys, "stdout", None)
    monkeypatch.setattr(sys, "stderr", None)
    with lasting_streams():
        print("text")
        print("text", file=sys.stderr)
        assert not sys.stdout.isatty()
        with pytest.raises(OSError, match="fileno"):
            sys.stdout.fileno()
    assert sys.stdout is sys.stderr is None


CLOSED = """
import os, sys
from vislam.cli.streams import lasting_streams
with lasting_streams():
    with open(sys.argv[1], "w") as file:
        os.write(1, b"what a library prints")
        os.write(2, b"what a library prints")
        file.write("kept")
"""


def test_no_file_gets_the_descriptor_of_a_closed_stream(tmp_path):
    path = tmp_path / "a.txt"
    command = [sys.executable, "-c", CLOSED, str(path)]
    shell = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", *command]
    assert subprocess.run(shell, cwd=ROOT, check=False).returncode == 0
    assert path.read_text() == "kept"


def test_the_interpreter_ends_well_after_a_full_disk():
    told = "from vislam.cli.streams import lasting_streams\nwith lasting_streams(): print('x' * 10**5)"
    with open(os.devnull, "rb"), open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-c", told], cwd=ROOT, stdout=full, stderr=subprocess.PIPE, check=False
        )
    assert (done.returncode, done.stderr) == (0, b"")
