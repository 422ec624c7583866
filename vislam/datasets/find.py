"""Where files are looked for."""

import os
from pathlib import Path

from vislam.datasets.download import cache_folder, recording_with


def search_path(data_dir: Path | None, *, config_dir: Path | None = None) -> list[Path]:
    """Folders in which files are looked for, in order.

    ``--data-dir``, the folder of the config file, ``$VISLAM_DATA``, the current folder, its ``data/``, and
    the user cache, where ``python -m vislam.fetch`` puts them.
    """
    variable = os.environ.get("VISLAM_DATA")
    named = [data_dir, config_dir, Path(variable) if variable else None]
    return [*(folder for folder in named if folder is not None), Path(), Path("data"), cache_folder()]


def find_file(name: str, folders: list[Path]) -> Path | None:
    """First file of that name in the folders, or None; an absolute path is one whatever the folders."""
    return next((folder / name for folder in folders if (folder / name).is_file()), None)


def find_path(name: str, folders: list[Path]) -> Path | None:
    """First file or folder of that name in the folders, or None; an absolute path is one in any case."""
    return next((folder / name for folder in folders if (folder / name).exists()), None)


def not_found(name: str, folders: list[Path]) -> str:
    """Say that a file is missing, where it was looked for and how it can be had."""
    if Path(name).is_absolute():
        return f"{name}: no such file; name the one that is there"
    looked = ", ".join(str(folder) for folder in dict.fromkeys(folders))
    known = recording_with(name)
    fetch = "" if known is None else f", or fetch it with python -m vislam.fetch {known}"
    return (
        f"{name}: not found in {looked}; put it into one of these folders, or name its folder "
        f"with --data-dir or $VISLAM_DATA{fetch}"
    )
