"""Identity: hashes of all that a result depends on, so that whatever has changed is computed again."""

import hashlib
import os
import re
import stat
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import cache, lru_cache
from importlib.machinery import EXTENSION_SUFFIXES, SOURCE_SUFFIXES, ModuleSpec
from importlib.metadata import Distribution, EntryPoint, PackageNotFoundError, entry_points, version
from importlib.util import find_spec
from pathlib import Path, PurePath
from platform import python_version_tuple
from typing import Any

import numpy as np
import scipy

from vislam.core.estimator import GROUP

_PACKAGE = str(__package__).partition(".")[0]
_ID_DIGITS = 10
_SOURCES = (*SOURCE_SUFFIXES, *EXTENSION_SUFFIXES)
_COMPUTE = ("gtsam", "numpy", "scipy")
"""Packages whose version changes numbers."""
_READING = ("data", "estimators")
"""Sections of a config that name what is read."""
_MOST_FILES = 20_000
"""Files of a folder that are looked at; the OXTS folder of the longest KITTI drive has 5,178."""
_MOST_BYTES = 1 << 30
"""Content of a folder that is read; of a file beyond it, size and time of change count."""
_CHUNK = 1 << 20
_YOUNG = 2_000_000_000
"""Age up to which a file is read each time [ns]."""

Key = tuple[str, ...]


@cache
def code_digest() -> str:
    """Hash of the source of vislam and of every installed estimator, and of what they compute with.

    The package or module of an estimator's entry point counts as a whole, and so do those that are installed
    along with it; of what it requires, the version counts. Nothing is imported for that: what raises or exits
    as it is imported has a hash like the others.
    """
    entries = sorted(entry_points(group=GROUP), key=lambda entry: (entry.name, entry.value))
    plugins = {str(entry.dist.name): entry.dist for entry in entries if entry.dist and not _ours(entry)}
    modules = {_PACKAGE: False, **{_top(entry.value): not _ours(entry) for entry in entries}}
    for distribution in plugins.values():
        modules = dict.fromkeys(_installed(distribution), True) | modules
    digest = hashlib.sha256()
    for text in (*_versions(plugins), *(f"{entry.name} = {entry.value}" for entry in entries)):
        _feed(digest, text)
    for name, whole in sorted(modules.items()):
        for label, path in _sources(name, whole=whole):
            _feed(digest, f"{name}/{label}", _content(path))
    return digest.hexdigest()[:_ID_DIGITS]


def inputs_digest(tree: Mapping[str, Any], folders: Sequence[Path]) -> str:
    """Hash of the content of all files that a config names; empty if it names none that is there.

    Whatever text under ``data`` and ``estimators`` names a file counts, so that the options of anybody's
    estimator are seen too, and so does the code of an estimator that is named by its module. A folder counts
    with all files below it, up to a bound; under ``data`` only where the key says ``folder``, as the name of
    a format may be that of a folder, too.

    Parameters
    ----------
    tree : mapping
        Config as plain data.
    folders : sequence of Path
        Where relative names are looked for beside the current folder. All files of a name count, as it is
        the reader who knows which place comes first.
    """
    named = [(key, text) for section in _READING for key, text in _texts(tree.get(section), (section,))]
    places = [Path(), *folders]
    # A reference may lie beside its recording.
    recordings = (path for key, text in named if key[0] == "data" for path in _files(text, places))
    places += sorted({path.parent for path in recordings})
    found = {f"{'.'.join(key)} {content}" for key, text in named for content in _contents(key, text, places)}
    found |= {f"{'.'.join(key)} {content}" for key, text in named for content in _code(key, text)}
    return combine(*sorted(found)) if found else ""


def combine(*parts: str) -> str:
    """Hash of texts in their order."""
    return hashlib.sha256("|".join(parts).encode(errors="surrogatepass")).hexdigest()[:_ID_DIGITS]


def _ours(entry: EntryPoint) -> bool:
    """Whether an estimator comes with vislam."""
    return entry.dist is not None and entry.dist.name == _PACKAGE


def _top(value: str) -> str:
    """First name of what an entry point refers to, ``my_package`` of ``my_package.sub:build``."""
    return re.split(r"[^\w]", value.strip(), maxsplit=1)[0]


def _installed(distribution: Distribution) -> Iterator[str]:
    """Modules at the top level that were installed together."""
    yield from (distribution.read_text("top_level.txt") or "").split()
    for file in distribution.files or ():
        name = file.parts[0].partition(".")[0]
        # The finder of an editable installation names a folder of this machine.
        if file.name.endswith(_SOURCES) and name.isidentifier() and not name.startswith("__editable__"):
            yield name


def _versions(plugins: Mapping[str, Distribution]) -> Iterator[str]:
    yield "python " + ".".join(python_version_tuple()[:2])
    yield from (f"{name} {_version(name)}" for name in _COMPUTE)
    # What is imported need not be what is installed: another may come before it on the path.
    yield from (np.__version__, scipy.__version__)
    for name, distribution in sorted(plugins.items()):
        yield f"{name} {distribution.version}"
        for requirement in distribution.requires or ():
            if found := re.match(r"[\w.-]+", requirement):
                yield f"{found[0]} {_version(found[0])}"


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "-"


def _sources(name: str, *, whole: bool) -> list[tuple[str, Path]]:
    """Files of a module or package by their names below it, in order.

    Of vislam the sources alone (``whole`` is false): a checkout has files that an installation has not, and
    both are the same code.
    """
    spec = _spec(name)
    if spec is None:
        return []
    if spec.submodule_search_locations is None:
        return [(origin.name, origin) for origin in _standing(Path(spec.origin or ""))]
    # What others keep in the same namespace, or what is a folder by chance, may be large.
    whole = whole and spec.origin is not None
    found = []
    for folder in map(Path, spec.submodule_search_locations):
        found += [(archive.name, archive) for archive in _standing(folder)]
        for path in folder.rglob("*"):
            label = path.relative_to(folder)
            if _belongs(label, whole=whole) and path.is_file():
                found.append((label.as_posix(), path))
    return sorted(found)


def _spec(name: str) -> ModuleSpec | None:
    """Where a module would be imported from; None if that is unknown."""
    try:
        return find_spec(name)
    except Exception:
        # Beside ImportError and ValueError, whatever somebody's finder raises.
        return None


def _standing(path: Path) -> list[Path]:
    """File that a path leads to, if any: itself, or the archive that it lies in."""
    return [place for place in (path, *path.parents) if place.is_file()][:1]


def _belongs(label: PurePath, *, whole: bool) -> bool:
    """Whether a file of a package is part of it, not a trace of its use."""
    if any(part.startswith(".") or part == "__pycache__" for part in label.parts):
        return False
    return label.name.endswith(_SOURCES) or (whole and not label.name.endswith((".pyc", "~")))


def _texts(value: Any, key: Key) -> Iterator[tuple[Key, str]]:
    """All texts of plain data, with the keys that lead there."""
    if isinstance(value, str):
        yield key, value
    elif isinstance(value, Mapping):
        for name, item in value.items():
            yield from _texts(item, (*key, str(name)))
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _texts(item, key)


def _named(text: str, places: Iterable[Path]) -> Iterator[Path]:
    """Where a text might lead as a path, each place once."""
    if text and "\0" not in text:
        names = (text, os.path.expandvars(os.path.expanduser(text)))
        yield from dict.fromkeys(place / name for name in names for place in places)


def _files(text: str, places: Iterable[Path]) -> Iterator[Path]:
    # A name that is too long, or that may not be looked at, raises with the methods of Path.
    return (path for path in _named(text, places) if os.path.isfile(path))


def _contents(key: Key, text: str, places: Iterable[Path]) -> Iterator[str]:
    """Hash of each file and folder that a text names."""
    yield from map(_content, _files(text, places))
    if key[0] != "data" or key[-1] == "folder":
        yield from (_folder(path) for path in _named(text, places) if os.path.isdir(path))


def _code(key: Key, text: str) -> Iterator[str]:
    """Hash of each source of an estimator that a config names by its module, ``my_module:build``."""
    if key[0] == "estimators" and key[-1] == "estimator" and ":" in text:
        for label, path in _sources(_top(text), whole=True):
            yield f"{label} {_content(path)}"


def _folder(folder: Path) -> str:
    """Hash of the names and contents of the files below a folder."""
    digest, left = hashlib.sha256(), _MOST_BYTES
    for number, (path, found) in enumerate(_walk(folder, set())):
        if number == _MOST_FILES:
            break
        fits = found.st_size <= left
        left -= found.st_size if fits else 0
        content = _content(path) if fits else f"{found.st_size} {found.st_mtime_ns}"
        _feed(digest, str(path.relative_to(folder)), content)
    return digest.hexdigest()


def _walk(folder: Path, seen: set[tuple[int, int]]) -> Iterator[tuple[Path, os.stat_result]]:
    """Regular files below a folder in order; what cannot be looked at is passed over, as are links back."""
    try:
        own, names = folder.stat(), sorted(os.listdir(folder))
    except OSError:
        return
    if (own.st_dev, own.st_ino) in seen or len(seen) == _MOST_FILES:
        return
    seen.add((own.st_dev, own.st_ino))
    for path in (folder / name for name in names):
        try:
            found = path.stat()
        except OSError:
            continue
        if stat.S_ISREG(found.st_mode):
            yield path, found
        elif stat.S_ISDIR(found.st_mode):
            yield from _walk(path, seen)


def _content(path: Path) -> str:
    """Hash of a file's content, or why there is none."""
    try:
        found = path.stat()
        # Within a tick of the clock a file can be changed twice: what is this young may be so again.
        read = _read if time.time_ns() - found.st_ctime_ns < _YOUNG else _remembered
        return read(str(path.resolve()), found.st_size, found.st_mtime_ns, found.st_ctime_ns)
    except OSError as error:
        return type(error).__name__


@lru_cache(maxsize=1 << 16)
def _remembered(path: str, size: int, *changed: int) -> str:
    """The same, read once for each size and times of change."""
    return _read(path, size, *changed)


def _read(path: str, size: int, *changed: int) -> str:
    """Hash of the content of a file."""
    digest = hashlib.sha256()
    with Path(path).open("rb") as file:
        # No more than it says to have: some that a system shows as files never end.
        while size > 0 and (chunk := file.read(min(size, _CHUNK))):
            digest.update(chunk)
            size -= len(chunk)
    return digest.hexdigest()


def _feed(digest: "hashlib._Hash", *texts: str) -> None:
    """Add texts so that none can take over the end of another."""
    for text in texts:
        part = text.encode(errors="surrogatepass")
        digest.update(b"%d:" % len(part))
        digest.update(part)
