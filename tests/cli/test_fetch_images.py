"""Recordings of images fetched as archives, from a server on this machine."""

import hashlib
import io
import zipfile
from dataclasses import replace

import pytest

from tests.cli.test_fetch import Server, cache, files_in, one_line, server  # noqa: F401
from vislam.cli.main import main as vislam
from vislam.datasets import archives
from vislam.datasets.archives import EUROC, image_set
from vislam.fetch import main

EUROC_ZIP = "MH_01_easy.zip"
DRIVE = "2011_09_26_drive_0001_sync"


def packed(files, *, damage=None):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_STORED) as file:
        for name, content in files.items():
            file.writestr(name, content)
    content = bytearray(stream.getvalue())
    if damage is not None:
        content[content.index(damage)] ^= 1
    return bytes(content)


MAV0 = packed(
    {"mav0/cam0/data.csv": "cam0", "mav0/imu0/data.csv": "imu0", "__MACOSX/mav0/x": "y", "more": ""}
)
SERVED = {
    EUROC_ZIP: MAV0,
    "2011_09_26_calib.zip": packed({f"2011_09_26/{name}": name for name in archives._CALIBRATION}),
    f"{DRIVE}.zip": packed({f"2011_09_26/{DRIVE}/image_00/timestamps.txt": "t"}),
}


@pytest.fixture
def serving(server, monkeypatch):  # noqa: F811
    """The server gives these files, by name."""
    given = dict(SERVED)

    def good(handler):
        content = given.get(handler.path.rpartition("/")[2])
        handler.send_response(404 if content is None else 200)
        handler.send_header("Content-Length", str(len(content or b"")))
        handler.end_headers()
        handler.wfile.write(content or b"")

    monkeypatch.setattr(Server, "given", given, raising=False)
    monkeypatch.setattr("tests.cli.test_fetch.Handler.good", lambda self, *_, **__: good(self))
    return server


def fetch(server, *names):  # noqa: F811
    return main([*names, "--base-url", server.url])


def test_a_sequence_of_euroc_is_unpacked_and_found_by_its_name(serving, cache, capsys):  # noqa: F811
    assert fetch(serving, "MH_01_easy") == 0
    said = capsys.readouterr().out
    assert f"SHA-256 {hashlib.sha256(MAV0).hexdigest()}, none is published to compare with" in said
    assert "Burri et al. 2016" in said
    assert (cache / "MH_01_easy" / "mav0" / "imu0" / "data.csv").read_text() == "imu0"
    # What is no part of it, and what was downloaded, is gone.
    assert files_in(cache) == ["MH_01_easy", "cam0", "data.csv", "data.csv", "imu0", "mav0"]
    assert fetch(serving, "MH_01_easy") == 0
    assert "already unpacked" in capsys.readouterr().out
    assert serving.asked == [f"/{EUROC_ZIP}"]
    # It is opened by its name: this one ends at its calibration.
    assert vislam(["compare", "--data", "MH_01_easy"]) == 2
    assert str(cache / "MH_01_easy") in one_line(capsys.readouterr().err)


def test_a_drive_of_kitti_raw_comes_with_the_calibration_of_its_day(serving, cache, capsys):  # noqa: F811
    assert fetch(serving, DRIVE) == 0
    assert f"vislam compare --data {cache / '2011_09_26' / DRIVE}" in capsys.readouterr().out
    day = cache / "2011_09_26"
    assert sorted(path.name for path in day.iterdir()) == [DRIVE, *archives._CALIBRATION]
    assert serving.asked == ["/2011_09_26_calib.zip", f"/{DRIVE}.zip"]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (None, "expected the file, got HTTP 404"),
        (b"<html>moved</html>", f"{EUROC_ZIP}: is no ZIP archive that can be read"),
        (MAV0[:-30], "is no ZIP archive that can be read"),
        (
            packed({"mav0/a": "0123456789"}, damage=b"0123456789"),
            "is no ZIP archive that can be read (Bad CRC-32",
        ),
        (packed({"other/a": ""}), "must have mav0, which is not in it"),
        (packed({"mav0/../../up": ""}), "which lies outside of it"),
        (packed({"/mav0/a": ""}), "which lies outside of it"),
    ],
)
def test_what_cannot_be_used_is_one_line_and_leaves_nothing(serving, cache, capsys, content, said):  # noqa: F811
    if content is None:
        del Server.given[EUROC_ZIP]
    else:
        Server.given[EUROC_ZIP] = content
    assert fetch(serving, "MH_01_easy") == 2
    assert said in one_line(capsys.readouterr().err)
    assert files_in(cache) in ([], ["MH_01_easy"])


def test_a_known_checksum_is_demanded(serving, cache, capsys, monkeypatch):  # noqa: F811
    known = image_set("MH_01_easy")
    for digest, code in (("0" * 64, 2), (hashlib.sha256(MAV0).hexdigest(), 0)):
        pinned = replace(known, archives=(replace(known.archives[0], sha256=digest),))
        monkeypatch.setattr(archives, "image_set", lambda _, pinned=pinned: pinned)
        assert fetch(serving, "MH_01_easy") == code
    said = capsys.readouterr()
    assert f"expected sha256 {'0' * 64}, got {hashlib.sha256(MAV0).hexdigest()}" in said.err
    assert "as pinned" in said.out


@pytest.mark.parametrize("behaviour", ["silent", "hung_up", "broken"])
def test_a_server_that_fails_is_one_line_with_the_page(serving, cache, capsys, behaviour):  # noqa: F811
    serving.behaviour = behaviour
    assert main(["MH_01_easy", "--base-url", serving.url, "--timeout", "0.3"]) == 2
    said = one_line(capsys.readouterr().err)
    assert said.startswith(f"vislam: {EUROC_ZIP}: could not be fetched; {serving.url}/{EUROC_ZIP}: ")
    assert "or get it from https://doi.org/10.3929/ethz-b-000690084 and unpack it" in said


def test_a_server_that_trickles_is_given_up(serving, cache, capsys):  # noqa: F811
    serving.behaviour = "trickling_head"
    assert main(["MH_01_easy", "--base-url", serving.url, "--timeout", "0.2"]) == 2
    assert "expected the file, got " in one_line(capsys.readouterr().err)


def test_names_and_where_they_are():
    for name in EUROC:
        assert image_set(name).archives[0].url.endswith(f"/{name}/{name}.zip")
    drive = image_set("2011_10_03_drive_0027_extract")
    assert drive.archives[1].url.endswith("/2011_10_03_drive_0027/2011_10_03_drive_0027_extract.zip")
    assert image_set("2011_10_03_drive_27_sync") is None
    assert image_set("ds3") is None


def test_one_that_is_not_here_is_to_be_fetched(cache, capsys):  # noqa: F811
    assert vislam(["track", "MH_01_easy", "-o", "a.npz"]) == 2
    assert "vislam fetch MH_01_easy brings it into the user cache" in one_line(capsys.readouterr().err)
