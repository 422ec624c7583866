"""Files that are written whole or not at all, and never in the place of anything but a file.

What is being written has a temporary name and is locked. A killed process leaves the file and no lock, so
that the next one can tell what nobody writes any more.
"""

import errno
import fcntl
import hashlib
import json
import os
import re
import secrets
import stat
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np

from vislam.base.errors import NotWrittenError, first_line
from vislam.base.types import Array

PLAIN = "plain"
"""Member of an archive that holds its plain data as JSON."""
_TEMPORARY = re.compile(r"\.vislam-[0-9a-f]{16}\.tmp")
_PROBE = b"\0" * 4096
"""What must fit at least."""
_REMEDY = "name another file or folder"
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
_LONGEST_NAME = 64
_HASH_DIGITS = 8


def check_writable(path: Path) -> None:
    """Raise NotWrittenError if a file could not be written there, before the work that would be lost.

    It is tried, as the superuser may do anything but write to a full or a read-only disk. Nothing stays of
    it; what a killed process has left in the folder goes as well.
    """
    with _told(path):
        _refuse_other_kinds(path)
        folder, missing = _nearest_folder(path.absolute().parent)
        longest = os.pathconf(folder, "PC_NAME_MAX")
        if any(len(os.fsencode(name)) > longest for name in (path.name, *missing)):
            raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
        with _held(folder) as probe:
            probe.write_bytes(_PROBE)
    sweep(path.parent)


@contextmanager
def replace_whole(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to, renamed to ``path`` if the block succeeds, else removed.

    Raises
    ------
    NotWrittenError
        If the file system refuses any of it, or ``path`` is there and is no regular file.
    """
    with _told(path):
        _refuse_other_kinds(path)
        path.parent.mkdir(parents=True, exist_ok=True)
        with _held(path.parent) as temporary:
            yield temporary
            temporary.replace(path)


def write_text(path: Path, text: str) -> None:
    """Write a text as UTF-8, whole or not at all; what UTF-8 does not know becomes an escape."""
    with replace_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def remove(path: Path) -> None:
    """Remove a file if it is there; NotWrittenError if it cannot be removed, or is no regular file."""
    with _told(path):
        _refuse_other_kinds(path)
        path.unlink(missing_ok=True)


def sweep(folder: Path) -> None:
    """Remove the temporary files that no process holds any more from a folder, if they can be."""
    with suppress(OSError):
        for name in filter(_TEMPORARY.fullmatch, os.listdir(folder)):
            with suppress(OSError):
                _remove_if_left(folder / name)


def folder_name(name: str) -> str:
    """Name of a folder or file for what people may call as they like: ASCII, of bounded length, never hidden.

    A name of letters, digits, ``_``, ``.`` and ``-`` that does not begin with ``.`` or ``-`` stands for
    itself; what is made of any other has a hash of it, so that no two share a folder.
    """
    if re.fullmatch(rf"[A-Za-z0-9_][A-Za-z0-9_.-]{{0,{_LONGEST_NAME - 1}}}", name):
        return name
    digest = hashlib.sha256(name.encode("utf-8", "surrogatepass")).hexdigest()[:_HASH_DIGITS]
    kept = re.sub(r"[^A-Za-z0-9.-]+", "_", name).strip("._-")[: _LONGEST_NAME - _HASH_DIGITS - 1]
    return "-".join(part for part in (kept, digest) if part)


def open_regular(path: Path) -> BufferedReader:
    """Open a file for reading; OSError if it is none: a pipe would be waited for, a device has no end."""
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    kind = _other_kind(os.fstat(handle).st_mode)
    if kind is not None:
        os.close(handle)
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
    return os.fdopen(handle, "rb")


def save_archive(path: Path, plain: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
    """Write plain data and arrays as one npz file, whole or not at all."""
    with replace_whole(path) as temporary, temporary.open("wb") as file:
        text = np.array(json.dumps(plain))
        np.savez_compressed(file, allow_pickle=False, **{**arrays, PLAIN: text})


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Turn what the file system refuses into one line."""
    try:
        yield
    except OSError as error:
        remedy = f"make room, or {_REMEDY}" if error.errno in _NO_ROOM else _REMEDY
        raise NotWrittenError(path, first_line(error), remedy) from error


def _refuse_other_kinds(path: Path) -> None:
    """Raise NotWrittenError if something is there that is no regular file; a link is not followed."""
    try:
        kind = _other_kind(path.lstat().st_mode)
    except FileNotFoundError:
        return
    if kind is not None:
        raise NotWrittenError(path, f"it is {kind}, and is left alone", _REMEDY)


def _other_kind(mode: int) -> str | None:
    """What a file is by its mode; None for a regular one."""
    kinds = {
        stat.S_IFREG: None,
        stat.S_IFDIR: "a folder",
        stat.S_IFLNK: "a symbolic link",
        stat.S_IFIFO: "a pipe",
        stat.S_IFSOCK: "a socket",
    }
    return kinds.get(stat.S_IFMT(mode), "a device")


def _nearest_folder(folder: Path) -> tuple[Path, list[str]]:
    """The folder itself or the nearest above it that is there, and the names of those that are not."""
    missing = []
    while True:
        try:
            folder.lstat()
            break
        except FileNotFoundError:
            missing.append(folder.name)
            folder = folder.parent
    if not folder.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, f"{folder} is in the way")
    return folder, missing


@contextmanager
def _held(folder: Path) -> Iterator[Path]:
    """Give an empty file with a temporary name, locked while it is written, removed if it is still there."""
    handle, temporary = _locked(folder)
    try:
        yield temporary
    finally:
        try:
            temporary.unlink(missing_ok=True)
        finally:
            os.close(handle)


def _locked(folder: Path) -> tuple[int, Path]:
    while True:
        temporary = folder / f".vislam-{secrets.token_hex(8)}.tmp"
        # Created with the mode that the user's mask leaves.
        handle = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        # Not every file system has locks; where there are none, nothing is taken for left either.
        with suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.fstat(handle).st_nlink:
            return handle, temporary
        # Another process took it for left before it was locked.
        os.close(handle)


def _remove_if_left(temporary: Path) -> None:
    handle = os.open(temporary, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        temporary.unlink()
    finally:
        os.close(handle)
