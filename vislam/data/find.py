"""Where files are looked for."""

import os
from pathlib import Path

from vislam.data.download import cache_folder, recording_with


def search_path(data_dir: Path | None) -> list[Path]:
    """Folders in which files are looked for: ``--data-dir``, ``$VISLAM_DATA``, ``data/``, the user cache.

    The last is where ``python -m vislam.fetch`` puts them.
    """
    variable = os.environ.get("VISLAM_DATA")
    folders = [data_dir, Path(variable) if variable else None, Path("data"), cache_folder()]
    return [folder for folder in folders if folder is not None]


def find_file(name: str, folders: list[Path]) -> Path | None:
    """First file of that name in the folders, or None."""
    return next((folder / name for folder in folders if (folder / name).is_file()), None)


def not_found(name: str, folders: list[Path]) -> str:
    """Say that a file is missing, where it was looked for and how it can be had."""
    looked = ", ".join(str(folder) for folder in folders)
    known = recording_with(name)
    fetch = "" if known is None else f", or fetch it with python -m vislam.fetch {known}"
    return (
        f"{name}: not found in {looked}; put it into one of these folders, or name its folder "
        f"with --data-dir or $VISLAM_DATA{fetch}"
    )
