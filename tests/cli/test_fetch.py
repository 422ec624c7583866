"""The download command against a server on this machine, one that behaves and one that does not."""

import hashlib
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from tests.conftest import recorded
from vislam.base.errors import DataError
from vislam.comparison.config import DataConfig
from vislam.comparison.open import open_dataset
from vislam.datasets import download
from vislam.datasets.download import RECORDINGS, Recording, RemoteFile, cache_folder
from vislam.datasets.find import find_file, search_path
from vislam.fetch import main

ROOT = Path(__file__).parents[2]
# Longer than one chunk of a download, so that a server can break off between two.
CONTENT = bytes(range(256)) * 800
PATIENCE = "0.3"


def pinned(name="tiny.npz", content=CONTENT, **changes):
    values = {"size": len(content), "sha256": hashlib.sha256(content).hexdigest(), "urls": ()}
    return RemoteFile(name=name, **{**values, **changes})


class Handler(BaseHTTPRequestHandler):
    """Does to every file what ``server.behaviour`` says, or what its path says."""

    protocol_version = "HTTP/1.1"

    def do_GET(self):
        self.server.asked.append(self.path)
        named = self.path.split("/")[1]
        getattr(self, named if hasattr(self, named) else self.server.behaviour)()

    def good(self, content=CONTENT, length=None):
        self.send_response(200)
        self.send_header("Content-Length", str(len(CONTENT) if length is None else length))
        self.end_headers()
        self.wfile.write(content)

    def changed(self):
        self.good(CONTENT[:-1] + b"x")

    def shorter(self):
        self.good(CONTENT[:-5], length=len(CONTENT) - 5)

    def longer(self):
        self.good(CONTENT + b"more", length=len(CONTENT) + 4)

    def half(self):
        self.good(CONTENT[: len(CONTENT) // 2])
        self.close_connection = True

    def silent(self):
        self.server.released.wait(10.0)
        self.close_connection = True

    def stalled(self):
        self.good(CONTENT[: len(CONTENT) // 2])
        self.silent()

    def hung_up(self):
        self.close_connection = True

    def trickling(self):
        self.good(b"")
        for value in CONTENT:
            self.wfile.write(bytes([value]))
            if self.server.released.wait(0.02):
                break

    def trickling_head(self):
        self.wfile.write(b"HTTP/1.1 200 OK\r\nX-Filler: ")
        while not self.server.released.wait(0.02):
            self.wfile.write(b"a")

    def absent(self):
        self.send_error(404)

    def broken(self):
        self.send_error(500)

    def log_message(self, *_):
        pass


class Server(ThreadingHTTPServer):
    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.behaviour = "good"
        self.asked = []
        self.released = threading.Event()

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}"

    def handle_error(self, *_):
        """A client that hangs up is part of the test."""


@pytest.fixture
def server(monkeypatch):
    for name in ("no_proxy", "NO_PROXY"):
        monkeypatch.setenv(name, "127.0.0.1")
    with Server() as running:
        thread = threading.Thread(target=running.serve_forever, args=(0.01,))
        thread.start()
        yield running
        running.released.set()
        running.shutdown()
        thread.join()


@pytest.fixture(autouse=True)
def tiny(monkeypatch):
    """A recording of made-up content in the registry."""
    monkeypatch.setitem(RECORDINGS, "tiny", Recording(title="made up", files=(pinned(),)))


@pytest.fixture
def cache(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("VISLAM_DATA", raising=False)
    monkeypatch.setenv("VISLAM_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def fetch(url, *options):
    return main(["tiny", "--base-url", url, *options])


def one_line(said):
    """The message, once it is certain that there is one."""
    assert said.startswith("vislam: ")
    assert said.count("\n") == 1
    assert said.endswith("\n")
    return said


def files_in(folder):
    return sorted(path.name for path in folder.rglob("*")) if folder.is_dir() else []


def test_a_fetched_file_is_found_and_not_fetched_again(server, cache, capsys):
    assert find_file("tiny.npz", search_path(None)) is None
    assert fetch(server.url) == 0
    said = capsys.readouterr()
    assert said.err == ""
    assert f"tiny.npz: downloaded, now in {cache}" in said.out
    assert "non-commercial use with attribution" in said.out
    assert "\x1b" not in said.out
    found = find_file("tiny.npz", search_path(None))
    assert found == cache / "tiny.npz"
    assert found.read_bytes() == CONTENT
    assert found.stat().st_mode & 0o133 == 0
    assert fetch(server.url) == 0
    assert f"tiny.npz: already in {cache} and good" in capsys.readouterr().out
    assert server.asked == ["/tiny.npz"]
    assert files_in(cache) == ["tiny.npz"]


REFUSALS = {
    "changed": f"expected sha256 {pinned().sha256}, got ",
    "shorter": f"expected {len(CONTENT)} bytes, got {len(CONTENT) - 5}",
    "longer": f"expected {len(CONTENT)} bytes, got more",
    "half": f"expected {len(CONTENT)} bytes, got: IncompleteRead({len(CONTENT) // 2} bytes read",
    "silent": f"expected {len(CONTENT)} bytes, got nothing for {PATIENCE} s",
    "stalled": f"expected {len(CONTENT)} bytes, got nothing for {PATIENCE} s",
    "hung_up": "Remote end closed connection without response",
    "absent": "expected the file, got HTTP 404 Not Found",
    "broken": "expected the file, got HTTP 500 Internal Server Error",
}


@pytest.mark.parametrize("behaviour", sorted(REFUSALS))
def test_what_a_server_does_wrong_gets_one_line_and_2_and_leaves_nothing(behaviour, server, cache, capsys):
    server.behaviour = behaviour
    # Only where nothing comes: a busy machine may keep a good server waiting for longer.
    options = ["--timeout", PATIENCE] if behaviour in ("silent", "stalled") else []
    started = time.monotonic()
    assert fetch(server.url, *options) == 2
    assert time.monotonic() - started < 5.0
    said = one_line(capsys.readouterr().err)
    assert said.startswith(f"vislam: tiny.npz: could not be fetched; {server.url}/tiny.npz: ")
    assert REFUSALS[behaviour] in said
    assert "--base-url" in said
    assert files_in(cache) == []
    server.behaviour = "good"
    assert fetch(server.url) == 0
    assert (cache / "tiny.npz").read_bytes() == CONTENT


UNREACHABLE = {
    "nobody listens": ("http://127.0.0.1:{port}", "Connection refused"),
    "no such host": ("http://nowhere.invalid", "nowhere.invalid"),
    "no URL": ("nowhere", "No scheme supplied"),
    "another protocol": ("ftp://127.0.0.1", "No connection adapters"),
}


@pytest.mark.parametrize("case", sorted(UNREACHABLE))
def test_no_server_gets_one_line_and_2(case, cache, capsys, monkeypatch):
    monkeypatch.setattr("socket.getaddrinfo", offline)
    with Server() as closed:
        port = closed.server_port
    url, message = UNREACHABLE[case]
    assert fetch(url.format(port=port)) == 2
    said = one_line(capsys.readouterr().err)
    assert "tiny.npz: could not be fetched" in said
    assert message in said
    assert files_in(cache) == []


def offline(host, port, *_, **__):
    """Name resolution of a machine that knows itself alone, so that no test asks a real one."""
    import socket

    if host != "127.0.0.1":
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")
    return [(socket.AF_INET, socket.SOCK_STREAM, 6, "", (host, port))]


def test_a_wrong_file_in_the_cache_stays_until_a_good_one_is_here(server, cache, capsys):
    cache.mkdir()
    (cache / "tiny.npz").write_bytes(b"wrong")
    server.behaviour = "half"
    assert fetch(server.url) == 2
    assert f"what is in {cache} under this name is not the pinned file" in one_line(capsys.readouterr().err)
    assert (cache / "tiny.npz").read_bytes() == b"wrong"
    server.behaviour = "good"
    assert fetch(server.url) == 0
    assert "tiny.npz: replaced a wrong one" in capsys.readouterr().out
    assert (cache / "tiny.npz").read_bytes() == CONTENT
    assert files_in(cache) == ["tiny.npz"]


def with_mirrors(monkeypatch, server, *behaviours):
    urls = tuple(f"{server.url}/{behaviour}/tiny.npz" for behaviour in behaviours)
    monkeypatch.setitem(RECORDINGS, "tiny", Recording(title="made up", files=(pinned(urls=urls),)))


def test_the_next_mirror_is_tried(server, cache, capsys, monkeypatch):
    with_mirrors(monkeypatch, server, "changed", "absent", "good", "broken")
    assert main(["tiny"]) == 0
    assert capsys.readouterr().err == ""
    assert server.asked == [f"/{name}/tiny.npz" for name in ("changed", "absent", "good")]
    assert (cache / "tiny.npz").read_bytes() == CONTENT


def test_where_all_mirrors_fail_each_is_quoted(server, cache, capsys, monkeypatch):
    with_mirrors(monkeypatch, server, "changed", "absent")
    assert main(["tiny"]) == 2
    said = one_line(capsys.readouterr().err)
    assert f"{server.url}/changed/tiny.npz: expected sha256" in said
    assert f"{server.url}/absent/tiny.npz: expected the file, got HTTP 404" in said
    assert files_in(cache) == []


def test_a_file_larger_than_the_free_space_is_not_asked_for(server, cache, capsys, monkeypatch):
    huge = Recording(title="made up", files=(pinned(size=10**18),))
    monkeypatch.setitem(RECORDINGS, "tiny", huge)
    assert fetch(server.url) == 2
    said = one_line(capsys.readouterr().err)
    assert f"tiny.npz: no room in {cache}: expected room for {10**18} bytes, got " in said
    assert "--folder" in said
    assert server.asked == []
    assert files_in(cache) == []


def process(prelude, server, cache):
    """The command as a process, with the recording of this file in its registry."""
    script = f"""
import sys
from tests.cli.test_fetch import pinned
from vislam.datasets.download import RECORDINGS, Recording
from vislam.fetch import main
RECORDINGS["tiny"] = Recording(title="made up", files=(pinned(),))
{prelude}
sys.exit(main(["tiny", "--base-url", {server.url!r}]))
"""
    return subprocess.Popen(
        [sys.executable, "-c", script],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        env={**os.environ, "VISLAM_CACHE": str(cache)},
    )


@pytest.mark.slow
def test_a_disk_that_takes_only_part_gets_one_line_and_2(server, cache):
    prelude = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (5000, 5000))"
    with process(prelude, server, cache) as running:
        _, said = running.communicate(timeout=20.0)
    assert running.returncode == 2
    assert f"tiny.npz: no room in {cache}: File too large" in one_line(said)
    assert files_in(cache) == []
    assert fetch(server.url) == 0


@pytest.mark.parametrize("behaviour", ["trickling", "trickling_head", "silent"])
def test_a_server_has_until_the_deadline_for_the_whole_file(behaviour, server, cache, capsys):
    server.behaviour = behaviour
    assert fetch(server.url, "--deadline", "0.3") == 2
    said = one_line(capsys.readouterr().err)
    assert f"{server.url}/tiny.npz: expected {len(CONTENT)} bytes in 0.3 s, got " in said
    assert files_in(cache) == []


def test_the_next_mirror_has_a_deadline_of_its_own(server, cache, monkeypatch):
    with_mirrors(monkeypatch, server, "trickling", "good")
    assert main(["tiny", "--deadline", "0.5"]) == 0
    assert (cache / "tiny.npz").read_bytes() == CONTENT


def test_without_a_deadline_a_server_has_as_long_as_the_file_is_large(server, cache, capsys, monkeypatch):
    monkeypatch.setattr(download, "SLOWEST", 1e9)
    server.behaviour = "trickling"
    assert fetch(server.url, "--timeout", "0.2") == 2
    assert "bytes in 0.4" in one_line(capsys.readouterr().err)


def a_pipe(path):
    os.mkfifo(path)


def a_folder(path):
    path.mkdir()


def a_loop(path):
    path.symlink_to(path.name)


def a_device(path):
    path.symlink_to("/dev/zero")


def a_link_to_a_wrong_file(path):
    path.with_name("other").write_bytes(CONTENT[:-1] + b"x")
    path.symlink_to("other")


@pytest.mark.parametrize("make", [a_pipe, a_folder, a_loop, a_device, a_link_to_a_wrong_file])
def test_a_cache_with_something_else_under_the_name_gets_one_line_and_2(make, server, cache, capsys):
    cache.mkdir()
    make(cache / "tiny.npz")
    before = (cache / "tiny.npz").lstat().st_ino
    assert fetch(server.url) == 2
    assert f"tiny.npz: cannot be written in {cache}: it is a " in one_line(capsys.readouterr().err)
    assert server.asked == []
    assert (cache / "tiny.npz").lstat().st_ino == before


def test_a_link_to_the_good_file_is_good(server, cache, capsys):
    cache.mkdir()
    (cache / "other").write_bytes(CONTENT)
    (cache / "tiny.npz").symlink_to("other")
    assert fetch(server.url) == 0
    assert "already in" in capsys.readouterr().out
    assert server.asked == []


@pytest.mark.slow
def test_an_interrupt_gets_one_line_and_130(server, cache):
    server.behaviour = "stalled"
    # A shell may start its background jobs with the interrupt ignored.
    prelude = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)"
    with process(prelude, server, cache) as running:
        deadline = time.monotonic() + 20.0
        while not server.asked and time.monotonic() < deadline:
            time.sleep(0.02)
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=20.0)
    assert running.returncode == 130
    assert one_line(said) == "vislam: interrupted\n"
    assert files_in(cache) == []


def test_a_file_in_the_place_of_the_folder_gets_one_line_and_2(server, tmp_path, capsys):
    (tmp_path / "taken").write_text("")
    for folder in (tmp_path / "taken", tmp_path / "taken" / "below"):
        assert fetch(server.url, "--folder", str(folder)) == 2
        said = one_line(capsys.readouterr().err)
        assert f"tiny.npz: cannot be written in {folder}: " in said
        assert "$VISLAM_CACHE" in said
    assert server.asked == []


# Root may write everywhere, so it becomes nobody, once what nobody may not read is imported.
BE_NOBODY = """
import os, pooch
if os.geteuid() == 0:
    try:
        os.setuid(65534)
    except OSError:
        sys.exit(77)
"""


@pytest.mark.slow
def test_a_folder_without_permission_gets_one_line_and_2(server):
    # Not in tmp_path, which nobody may not even enter.
    with tempfile.TemporaryDirectory() as folder:
        Path(folder).chmod(0o555)
        with process(BE_NOBODY, server, folder) as running:
            _, said = running.communicate(timeout=20.0)
        if running.returncode == 77:
            pytest.skip("root may not become somebody else here")
        assert running.returncode == 2
        assert f"tiny.npz: cannot be written in {folder}: Permission denied; " in one_line(said)
        assert files_in(Path(folder)) == []
    assert server.asked == []


def test_unknown_names_are_said_before_anything_is_downloaded(server, cache, capsys):
    assert main(["tiny", "ds33", "--base-url", server.url]) == 2
    assert one_line(capsys.readouterr().err) == (
        "vislam: ds33: no such recording; known are ds3, kitti07, tiny, those of EuRoC (MH_01_easy ...) "
        "and of KITTI raw (DATE_drive_NNNN_sync or DATE_drive_NNNN_extract); --list lists them\n"
    )
    assert main([]) == 2
    assert "ds3, kitti07" in one_line(capsys.readouterr().err)
    assert server.asked == []
    assert not cache.exists()


def test_several_recordings_and_what_cannot_be_fetched(server, cache, capsys, monkeypatch):
    other = Recording(
        title="two", files=(pinned("a.npz"), pinned("b.txt")), missing="its reference is not public"
    )
    monkeypatch.setitem(RECORDINGS, "other", other)
    assert main(["tiny", "other", "--base-url", server.url + "/"]) == 0
    assert files_in(cache) == ["a.npz", "b.txt", "tiny.npz"]
    assert "other: its reference is not public" in capsys.readouterr().out
    assert server.asked == ["/tiny.npz", "/a.npz", "/b.txt"]


def test_the_bytes_that_are_here_are_counted_over_all_files(server, cache, monkeypatch):
    monkeypatch.setitem(RECORDINGS, "tiny", Recording(title="two", files=(pinned("a"), pinned("b"))))
    counts = []
    paths = download.fetch("tiny", base_url=server.url, watch=counts.append)
    assert paths == [cache / "a", cache / "b"]
    assert counts == sorted(counts)
    assert counts[-1] == RECORDINGS["tiny"].size == 2 * len(CONTENT)


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "soon"])
def test_a_timeout_that_is_none_is_refused(text, capsys):
    with pytest.raises(SystemExit, match="2"):
        main(["tiny", "--timeout", text])
    assert f"got {text}" in capsys.readouterr().err


def test_the_list_creates_nothing(cache, capsys):
    assert main(["--list"]) == 0
    said = capsys.readouterr().out
    assert "ds3: KITTI-360 drive 0003; 03.npz (1503997 bytes)" in said
    assert f"into {cache}" in said
    assert not cache.exists()


def test_the_cache_folder_is_named_and_not_created(cache, monkeypatch, tmp_path):
    assert search_path(None)[-1] == cache_folder() == cache
    monkeypatch.setenv("VISLAM_CACHE", "~/there")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / "there"
    monkeypatch.delenv("VISLAM_CACHE")
    assert cache_folder().name == "vislam"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("cache")
def test_a_missing_recording_that_can_be_fetched_says_how():
    with pytest.raises(DataError, match=r"or fetch it with python -m vislam\.fetch tiny$"):
        open_dataset(DataConfig(file="tiny.npz"), seed=0)
    with pytest.raises(DataError, match=r"VISLAM_DATA$"):
        open_dataset(DataConfig(file="another.npz"), seed=0)


SHIPPED = [file for name in ("ds3", "kitti07") for file in RECORDINGS[name].files]


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.name)
def test_pins_are_whole(file):
    assert re.fullmatch("[0-9a-f]{64}", file.sha256)
    assert file.urls
    for url in file.urls:
        # A branch would move on under the checksum, a commit does not.
        assert re.fullmatch(r"https://raw\.githubusercontent\.com/[\w-]+/[\w-]+/[0-9a-f]{40}/[\w./-]+", url)


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.name)
def test_pins_are_those_of_the_recorded_files(file):
    content = recorded(file.name).read_bytes()
    assert (len(content), hashlib.sha256(content).hexdigest()) == (file.size, file.sha256)
