"""Files that are written whole or not at all."""

import json
import os
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from vislam.errors import DataError
from vislam.types import Array

PLAIN = "plain"
"""Member of an archive that holds its plain data as JSON."""


def check_writable(path: Path) -> None:
    """Raise DataError if a file could not be written there, before the work that would be lost."""
    folder = path.resolve().parent
    while not folder.exists():
        folder = folder.parent
    if not folder.is_dir() or not os.access(folder, os.W_OK) or path.is_dir():
        raise DataError(f"{path}: cannot be written there; name another file or folder")


@contextmanager
def replace_whole(path: Path) -> Iterator[Path]:
    """Give a temporary name to write to, renamed to ``path`` if the block succeeds, else removed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
    os.close(handle)
    temporary = Path(name)
    try:
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


def save_archive(path: Path, plain: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
    """Write plain data and arrays as one npz file, whole or not at all."""
    with replace_whole(path) as temporary, temporary.open("wb") as file:
        text = np.array(json.dumps(plain))
        np.savez_compressed(file, allow_pickle=False, **{**arrays, PLAIN: text})
