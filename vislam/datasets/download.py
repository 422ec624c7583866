"""Recordings that can be fetched: where they are, what they must be, and how they get into the user cache.

A file is good if its SHA-256 is the pinned one. Nothing else is ever given its name: it is checked in memory,
written under a temporary name and renamed. However slow a server is, it has until a deadline.
"""

import errno
import hashlib
import logging
import os
import shutil
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from vislam.base.errors import DataError, NotWrittenError
from vislam.base.files import check_writable, open_regular, replace_whole

TIMEOUT = 30.0
"""Seconds without a byte after which a server is given up."""
SLOWEST = 20_000.0
"""Bytes a second that a server must give on the whole, if no deadline is named."""

LICENCE = (
    "KITTI and KITTI-360 are published for non-commercial use with attribution "
    "(Geiger et al. 2013; Liao, Xie and Geiger 2022)"
)
EUROC_LICENCE = "EuRoC is published for non-commercial use with attribution (Burri et al. 2016)"

_log = logging.getLogger("vislam.datasets")
_CHUNK = 1 << 16
_NO_ROOM = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)
_GITHUB = "https://raw.githubusercontent.com"


@dataclass(frozen=True)
class RemoteFile:
    """One file, pinned.

    Attributes
    ----------
    name : str
        In the cache, and behind ``--base-url``.
    size : int
        In bytes.
    sha256 : str
    urls : tuple of str
        Mirrors, tried in this order.
    """

    name: str
    size: int
    sha256: str
    urls: tuple[str, ...]


@dataclass(frozen=True)
class Recording:
    """Files that are fetched together.

    Attributes
    ----------
    title : str
    files : tuple of RemoteFile
    missing : str or None
        What belongs to the recording and cannot be fetched, and why.
    """

    title: str
    files: tuple[RemoteFile, ...]
    missing: str | None = None

    @property
    def size(self) -> int:
        """Bytes of all files."""
        return sum(file.size for file in self.files)


RECORDINGS: dict[str, Recording] = {
    "ds3": Recording(
        title="KITTI-360 drive 0003",
        files=(
            RemoteFile(
                name="03.npz",
                size=1503997,
                sha256="fdfd30237cb0a5697625af7392acc2a241c2be299a7d5cf2d0e189fa95a1f0c9",
                urls=(
                    f"{_GITHUB}/lmqZach/Visual-Inertial-SLAM/7275cbd01c8b50f4fc6f181af4e866b9852e8ca5/data/03.npz",
                    f"{_GITHUB}/vatch123/Visual-Inertial-SLAM/3753e49e04420112d520a775e60c233fc0be588b/data/03.npz",
                ),
            ),
        ),
        missing=(
            "its reference 03_positions_xy.txt has no public mirror: "
            "KITTI-360 poses need a registration at https://www.cvlibs.net/datasets/kitti-360/"
        ),
    ),
    "kitti07": Recording(
        title="KITTI odometry 07, and its poses",
        files=(
            RemoteFile(
                name="0027.npz",
                size=1640745,
                sha256="0d15fddc2f9c4623a4ab4c51621435fd9178694375ea6a530015c05b29e644e8",
                urls=(
                    f"{_GITHUB}/yahsiuhsieh/visual-inertial-slam/7a737a7914edac587ff2f3ba19f2bdaee8c65c2e/data/0027.npz",
                ),
            ),
            RemoteFile(
                name="0027_poses.txt",
                size=176684,
                sha256="7eb020916003a09a6b9c2744748eaadef54b96f6df22ee703a05a1d19bfe913a",
                urls=(
                    f"{_GITHUB}/Huangying-Zhan/kitti-odom-eval/4b850b0815dcd28edef893ca3422125b04a02397"
                    "/dataset/kitti_odom/gt_poses/07.txt",
                ),
            ),
        ),
    ),
}


class RefusedError(Exception):
    """What one server did wrong; the next mirror may do better."""


class Sink(Protocol):
    """What a download is written into."""

    wanted: bool
    """Whether anybody waits for it; writing fails then."""

    def write(self, chunk: bytes) -> None:
        """Take a piece."""

    def flush(self) -> None:
        """Do what is to be done; pooch asks a file for it."""


class SizedSink(Sink, Protocol):
    """One that knows how many bytes it has."""

    size: int


class _Bounded:
    """A file in memory, of known size, so that no server can fill it with more."""

    def __init__(self, limit: int, watch: Callable[[int], None]) -> None:
        self.content = bytearray()
        self.wanted = True
        """Whether anybody waits for it."""
        self._limit = limit
        self._watch = watch

    def write(self, chunk: bytes) -> None:
        if not self.wanted:
            raise ValueError("expected before the deadline")
        if len(self.content) + len(chunk) > self._limit:
            raise ValueError(f"expected {self._limit} bytes, got more")
        self.content += chunk
        self._watch(len(self.content))

    def flush(self) -> None:
        """Do nothing; pooch asks a file for it."""


def cache_folder() -> Path:
    """Folder of fetched files, ``$VISLAM_CACHE`` or the user's; it need not exist."""
    variable = os.environ.get("VISLAM_CACHE")
    if variable:
        return Path(os.path.expanduser(variable))
    # Imported where needed: who names the folder does not pay for it.
    import pooch  # noqa: PLC0415

    return Path(pooch.os_cache("vislam"))


def recording(name: str) -> Recording:
    """Recording of that name.

    Raises
    ------
    DataError
        If there is none.
    """
    if name not in RECORDINGS:
        raise DataError(f"{name}: no such recording; known are {', '.join(sorted(RECORDINGS))}")
    return RECORDINGS[name]


def recording_with(file_name: str) -> str | None:
    """Name of the recording that a file belongs to, or None."""
    for name, known in RECORDINGS.items():
        if any(file.name == file_name for file in known.files):
            return name
    return None


def fetch(
    name: str,
    *,
    base_url: str | None = None,
    folder: Path | None = None,
    timeout: float = TIMEOUT,
    deadline: float | None = None,
    say: Callable[[str], None] = _log.info,
    watch: Callable[[int], None] = lambda _: None,
) -> list[Path]:
    """Bring the files of a recording into the cache, those that are not there yet.

    Parameters
    ----------
    name : str
    base_url : str, optional
        Server in place of the mirrors; a file is looked for at ``base_url/<file name>``.
    folder : Path, optional
        In place of the cache.
    timeout : float
        Seconds without a byte after which a server is given up.
    deadline : float, optional
        Seconds after which a server that has not given a whole file is given up; without it, what it takes at
        ``SLOWEST``, and twice the timeout.
    say : callable
        Is given a line on what became of each file.
    watch : callable
        Is given the number of bytes that are here.

    Raises
    ------
    DataError
        If the name is unknown or a file cannot be had; the files before it stay.
    """
    place = cache_folder() if folder is None else Path(os.path.expanduser(folder))
    before = 0
    paths = []
    for file in recording(name).files:
        urls = file.urls if base_url is None else (f"{base_url.rstrip('/')}/{file.name}",)

        def count(received: int, before: int = before) -> None:
            watch(before + received)

        limits = _Limits(timeout, file.size / SLOWEST + 2.0 * timeout if deadline is None else deadline)
        try:
            became = _bring(file, place, urls=urls, limits=limits, watch=count)
        except NotWrittenError as error:
            raise DataError(_not_written(file, place, error)) from error
        say(became)
        before += file.size
        paths.append(place / file.name)
    return paths


@dataclass(frozen=True)
class _Limits:
    """How long a server may take: without a byte, and for the whole file [s]."""

    timeout: float
    deadline: float


def _bring(
    file: RemoteFile, folder: Path, *, urls: tuple[str, ...], limits: _Limits, watch: Callable[[int], None]
) -> str:
    """Have the file in the folder; says how it got there."""
    path = folder / file.name
    there = os.path.lexists(path)
    if there and _is_good(path, file):
        return f"{file.name}: already in {folder} and good, not downloaded again"
    check_writable(path)
    folder.mkdir(parents=True, exist_ok=True)
    free = shutil.disk_usage(folder).free
    if free < file.size:
        why = f"expected room for {file.size} bytes, got {free}"
        raise NotWrittenError(path, why, "make room") from OSError(errno.ENOSPC, why)
    said = []
    for url in urls:
        try:
            content = _download(file, url=url, limits=limits, watch=watch)
        except RefusedError as error:
            said.append(f"{url}: {error}")
        else:
            with replace_whole(path) as temporary:
                temporary.write_bytes(content)
            return f"{file.name}: {'replaced a wrong one' if there else 'downloaded'}, now in {folder}"
    if there:
        said.append(f"what is in {folder} under this name is not the pinned file")
    raise DataError(
        f"{file.name}: could not be fetched; {'; '.join(said)}; "
        "check the connection and try again, or name another server with --base-url"
    )


def _is_good(path: Path, file: RemoteFile) -> bool:
    """Whether it is the pinned file; what cannot be read is not, nor is a pipe or a device."""
    try:
        with open_regular(path) as stream:
            if os.fstat(stream.fileno()).st_size != file.size:
                return False
            return hashlib.file_digest(stream, "sha256").hexdigest() == file.sha256
    except OSError:
        return False


def _download(file: RemoteFile, *, url: str, limits: _Limits, watch: Callable[[int], None]) -> bytearray:
    """Fetch from one server and check; RefusedError says what it did wrong.

    A thread of its own does it, which is left to itself at the deadline: a server that gives a byte now and
    then would keep the HTTP client for ever, and so may the resolution of a name.
    """
    received = _Bounded(file.size, watch)
    wanted = f"{file.size} bytes"
    thread, failed = _begun(url, received, timeout=limits.timeout)
    try:
        thread.join(limits.deadline)
    finally:
        received.wanted = False
    if thread.is_alive():
        got = len(received.content)
        raise RefusedError(f"expected {wanted} in {limits.deadline:g} s, got {got}")
    _raise(failed, wanted, timeout=limits.timeout)
    _check(file, received.content)
    return received.content


def download_unsized(url: str, sink: SizedSink, *, timeout: float, deadline: float | None) -> None:
    """Fetch what has a size that is not known; RefusedError says what the server did wrong.

    Without a deadline it has two timeouts, and then must have given ``SLOWEST`` on the mean.
    """
    thread, failed = _begun(url, sink, timeout=timeout)
    started = time.monotonic()
    try:
        while thread.is_alive():
            thread.join(min(1.0, timeout))
            spent = time.monotonic() - started
            slow = spent > 2.0 * timeout + sink.size / SLOWEST if deadline is None else spent > deadline
            if thread.is_alive() and slow:
                raise RefusedError(f"expected the file, got {sink.size} bytes in {spent:.1f} s")
    finally:
        sink.wanted = False
    _raise(failed, "the file", timeout=timeout)


def _begun(url: str, sink: Sink, *, timeout: float) -> tuple[threading.Thread, list[Exception]]:
    """A thread that fetches into a sink, and where it leaves what it failed by."""
    failed: list[Exception] = []

    def request() -> None:
        try:
            _request(url, sink, timeout=timeout)
        except Exception as error:
            failed.append(error)

    thread = threading.Thread(target=request, daemon=True)
    thread.start()
    return thread, failed


def _raise(failed: list[Exception], wanted: str, *, timeout: float) -> None:
    """Raise what a request failed by, as a RefusedError if it is the server's or the disk's."""
    if not failed:
        return
    error = failed[0]
    if not isinstance(error, OSError | ValueError):
        raise error
    raise RefusedError(_reason(error, wanted, timeout=timeout)) from error


def _request(url: str, received: Sink, *, timeout: float) -> None:
    # It imports an HTTP client, which only a download needs.
    import pooch  # noqa: PLC0415

    pooch.HTTPDownloader(timeout=timeout, chunk_size=_CHUNK)(url, received, None)


def _check(file: RemoteFile, content: bytearray) -> None:
    if len(content) != file.size:
        raise RefusedError(f"expected {file.size} bytes, got {len(content)}")
    got = hashlib.sha256(content).hexdigest()
    if got != file.sha256:
        raise RefusedError(f"expected sha256 {file.sha256}, got {got}")


def _reason(error: Exception, wanted: str, *, timeout: float) -> str:
    """One plain line for what the HTTP client wraps three deep."""
    response = getattr(error, "response", None)
    if response is not None:
        # An answer that is not read to its end holds its socket.
        response.close()
        return " ".join(f"expected the file, got HTTP {response.status_code} {response.reason}".split())
    if "timed out" in str(error):
        return f"expected {wanted}, got nothing for {timeout:g} s"
    inner: BaseException = error
    while (deeper := _cause(inner)) is not None:
        inner = deeper
    text = " ".join(str(inner).split())
    if text.startswith(("HTTP", "<")):
        # "HTTPConnection(host=..., port=...): " repeats the URL.
        text = text.partition(": ")[2]
    return text if text.startswith("expected") else f"expected {wanted}, got: {text}"


def _cause(error: BaseException) -> BaseException | None:
    """What an exception of the HTTP client wraps: its ``reason``, or one of its arguments."""
    candidates = (getattr(error, "reason", None), *error.args)
    return next((item for item in candidates if isinstance(item, BaseException)), None)


def _not_written(file: RemoteFile, folder: Path, error: NotWrittenError) -> str:
    cause = error.__cause__
    no_room = isinstance(cause, OSError) and cause.errno in _NO_ROOM
    what = "no room" if no_room else "cannot be written"
    return (
        f"{file.name}: {what} in {folder}: {error.why}; "
        f"{'make room' if no_room else 'make it a folder that you may write to'}, "
        "or name another with --folder or $VISLAM_CACHE"
    )
