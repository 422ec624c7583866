"""Files that are written whole or not at all, refused before the work, and swept up after a kill."""

import os
import pickle
import re
import signal
import socket
import stat
import subprocess
import sys
import tempfile
from contextlib import contextmanager
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.limits import limited
from vislam.base.errors import NotWrittenError
from vislam.base.files import (
    check_writable,
    folder_name,
    open_regular,
    remove,
    replace_whole,
    save_archive,
    sweep,
    write_text,
)

ROOT = Path(__file__).parents[1]
LEFT = ".vislam-0123456789abcdef.tmp"


@contextmanager
def masked(mask):
    before = os.umask(mask)
    try:
        yield
    finally:
        os.umask(before)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_failed_write_leaves_what_was_there(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text("old")

    def fail():
        with replace_whole(path) as temporary:
            temporary.write_text("half")
            raise ValueError("stop")

    with pytest.raises(ValueError, match="stop"):
        fail()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("mask", [0o022, 0o002, 0o077, 0o027])
def test_a_file_has_the_mode_that_the_mask_leaves(tmp_path, mask):
    with masked(mask):
        write_text(tmp_path / "a.txt", "new")
    assert (tmp_path / "a.txt").stat().st_mode & 0o777 == 0o666 & ~mask


def folder(path):
    path.mkdir()


def link(path):
    path.with_name("target").write_text("kept")
    path.symlink_to("target")


def dangling_link(path):
    path.symlink_to("target")


def pipe(path):
    os.mkfifo(path)


def socket_file(path):
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(path))


OTHER_KINDS = {
    folder: "a folder",
    link: "a symbolic link",
    dangling_link: "a symbolic link",
    pipe: "a pipe",
    socket_file: "a socket",
}


@pytest.mark.parametrize("make", OTHER_KINDS, ids=lambda make: make.__name__)
def test_what_is_no_regular_file_is_left_alone(tmp_path, monkeypatch, make):
    # The path of a socket has a bounded length.
    monkeypatch.chdir(tmp_path)
    path = Path("out")
    make(path)
    before = path.lstat(), names(tmp_path)
    for attempt in (check_writable, remove, lambda path: write_text(path, "new")):
        with pytest.raises(NotWrittenError, match=f"it is {OTHER_KINDS[make]}, and is left alone"):
            attempt(path)
    assert (path.lstat().st_mode, path.lstat().st_ino) == (before[0].st_mode, before[0].st_ino)
    assert names(tmp_path) == before[1]
    assert not (tmp_path / "target").exists() or (tmp_path / "target").read_text() == "kept"


@pytest.mark.parametrize("device", ["/dev/null", "/dev/full"])
def test_a_device_is_left_alone(device):
    for attempt in (check_writable, lambda path: write_text(path, "new")):
        with pytest.raises(NotWrittenError, match="a device"):
            attempt(Path(device))
    assert stat.S_ISCHR(os.stat(device).st_mode)


def test_a_folder_may_be_a_link(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "link").symlink_to("real")
    path = tmp_path / "link" / "new" / "a.txt"
    check_writable(path)
    write_text(path, "new")
    assert (tmp_path / "real" / "new" / "a.txt").read_text() == "new"
    assert (tmp_path / "link").is_symlink()


def test_a_place_that_can_be_written_is_left_as_it_was(tmp_path):
    check_writable(tmp_path / "new" / "deeper" / "a.yaml")
    (tmp_path / "b.yaml").write_text("old")
    check_writable(tmp_path / "b.yaml")
    assert names(tmp_path) == ["b.yaml"]
    assert (tmp_path / "b.yaml").read_text() == "old"


REFUSED = {
    "a file in the way": (lambda base: base / "file" / "a.yaml", "Not a directory"),
    "a file further up": (lambda base: base / "file" / "new" / "a.yaml", "Not a directory"),
    "a dangling link in the way": (lambda base: base / "link" / "a.yaml", "link is in the way"),
    "a name too long": (lambda base: base / ("a" * 300), "File name too long"),
    "a name too long in bytes": (lambda base: base / ("ä" * 200), "File name too long"),
    "a new folder's name too long": (lambda base: base / ("a" * 300) / "a.yaml", "File name too long"),
    "the same further down": (lambda base: base / "new" / ("a" * 300) / "a.yaml", "File name too long"),
    "a path too long": (lambda base: base.joinpath(*["a" * 200] * 25), "File name too long"),
    "the folder itself": (lambda base: base, "a folder"),
}


@pytest.mark.parametrize("case", sorted(REFUSED))
def test_what_cannot_be_written_is_said_at_once_and_in_the_end(tmp_path, case):
    (tmp_path / "file").write_text("x")
    (tmp_path / "link").symlink_to("nowhere")
    place, why = REFUSED[case]
    for attempt in (check_writable, lambda path: write_text(path, "new")):
        with pytest.raises(NotWrittenError, match="cannot be written") as caught:
            attempt(place(tmp_path))
        assert "\n" not in str(caught.value)
    with pytest.raises(NotWrittenError, match=why):
        check_writable(place(tmp_path))
    assert (tmp_path / "file").read_text() == "x"


def test_a_full_disk_is_said_at_once(tmp_path):
    with limited(100), pytest.raises(NotWrittenError, match=r"File too large\); make room"):
        check_writable(tmp_path / "a.yaml")
    assert names(tmp_path) == []


@given(size=st.integers(min_value=0, max_value=3000))
def test_a_disk_that_fills_up_leaves_what_was_there(size):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.npz"
        path.write_bytes(b"old")
        array = {"a": os.urandom(3000).hex()}
        with limited(size), pytest.raises(NotWrittenError, match="File too large"):
            save_archive(path, array, {})
        assert path.read_bytes() == b"old"
        assert names(path.parent) == ["a.npz"]


def test_an_error_of_the_file_system_can_be_sent_to_another_process():
    error = NotWrittenError(Path("a"), "No space left on device", "make room")
    again = pickle.loads(pickle.dumps(error))
    assert str(again) == str(error) == "a: cannot be written (No space left on device); make room"
    assert again.why == "No space left on device"


KILLED = """
import os, signal, sys
from pathlib import Path
from vislam.base.files import replace_whole
with replace_whole(Path(sys.argv[1])) as temporary:
    temporary.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_goes_at_the_next_start(tmp_path):
    path = tmp_path / "a.txt"
    ended = subprocess.run([sys.executable, "-c", KILLED, str(path)], cwd=ROOT, check=False)
    assert ended.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert left.read_text() == "half"
    check_writable(path)
    assert names(tmp_path) == []


WRITING = """
import sys
from pathlib import Path
from vislam.base.files import replace_whole
with replace_whole(Path(sys.argv[1])) as temporary:
    temporary.write_text("whole")
    print("writing", flush=True)
    sys.stdin.read()
"""


def test_what_another_process_is_writing_is_not_swept_up(tmp_path):
    path = tmp_path / "a.txt"
    arguments = [sys.executable, "-c", WRITING, str(path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(arguments, cwd=ROOT, **pipes) as other:
        assert other.stdout.readline() == "writing\n"
        sweep(tmp_path)
        other.communicate()
    assert other.returncode == 0
    assert path.read_text() == "whole"


def test_only_what_is_left_is_swept_up(tmp_path):
    other = [".vislam", ".vislam-0123.tmp", f"{LEFT}.txt", f"a{LEFT}", ".a.yaml.abcd1234"]
    for name in (*other, LEFT):
        (tmp_path / name).write_text("x")
    with replace_whole(tmp_path / "a.txt") as temporary:
        sweep(tmp_path)
        assert names(tmp_path) == sorted([*other, temporary.name])
    sweep(tmp_path / "nowhere")


def test_a_link_with_the_name_of_a_temporary_file_is_not_followed(tmp_path):
    (tmp_path / "kept").write_text("x")
    (tmp_path / LEFT).symlink_to("kept")
    sweep(tmp_path)
    assert names(tmp_path) == [LEFT, "kept"]


@given(st.text())
def test_a_folder_of_any_name_lies_in_its_folder(name):
    found = folder_name(name)
    assert re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}", found)
    assert folder_name(found) == found
    assert Path("out", found).parent == Path("out")


@given(st.text(), st.text())
def test_two_names_have_two_folders(one, other):
    assert (folder_name(one) == folder_name(other)) == (one == other)


@pytest.mark.parametrize("name", ["tiny", "a.b-c_d", "_x", "9", "a" * 64, "a.."])
def test_a_plain_name_is_the_name_of_its_folder(name):
    assert folder_name(name) == name


@pytest.mark.parametrize(
    ("name", "begins"),
    [
        ("kitti [/07]", "kitti_07-"),
        ("../../etc", "etc-"),
        ("..", ""),
        ("-rf", "rf-"),
        (".hidden", "hidden-"),
        ("a" * 65, "a" * 55 + "-"),
        ("a/b", "a_b-"),
        ("ä", ""),
        ("a\n", "a-"),
    ],
)
def test_any_other_has_a_name_like_it_and_a_hash(name, begins):
    assert re.fullmatch(re.escape(begins) + "[0-9a-f]{8}", folder_name(name))


def test_only_a_regular_file_is_opened(tmp_path):
    (tmp_path / "a").write_text("x")
    (tmp_path / "link").symlink_to("a")
    with open_regular(tmp_path / "link") as file:
        assert file.read() == b"x"
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    for path in (tmp_path, tmp_path / "pipe", Path("/dev/zero"), tmp_path / "loop", tmp_path / "no"):
        with pytest.raises(OSError, match=r"not a file|symbolic links|No such file"):
            open_regular(path)


AS_NOBODY = """
import os, sys
from pathlib import Path
from vislam.base.errors import NotWrittenError
from vislam.base.files import check_writable, write_text
if os.geteuid() == 0:
    try:
        os.setuid(65534)
    except OSError:
        sys.exit(77)
for attempt in (check_writable, lambda path: write_text(path, "new")):
    try:
        attempt(Path(sys.argv[1]))
    except NotWrittenError as error:
        print(error)
"""


@pytest.mark.parametrize(("mode", "below"), [(0o555, "a.yaml"), (0o444, "new/a.yaml"), (0, "a.yaml")])
def test_a_folder_without_permission_is_said_at_once(mode, below):
    # Not in tmp_path, which nobody may not even enter.
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(mode)
        arguments = [sys.executable, "-c", AS_NOBODY, f"{folder}/{below}"]
        done = subprocess.run(arguments, cwd=ROOT, capture_output=True, text=True, check=False)
        Path(folder).chmod(0o700)
        if done.returncode == 77:
            pytest.skip("root may not become somebody else here")
        assert done.stderr == ""
        lines = done.stdout.splitlines()
        assert len(lines) == 2
        assert all(": cannot be written (Permission denied); " in line for line in lines)
        assert names(Path(folder)) == []
