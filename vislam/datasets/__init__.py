"""Recordings and references: one reader a format."""

from pathlib import Path

from vislam.core.sequence import Sequence
from vislam.datasets.find import find_file, not_found, search_path

__all__ = ["open"]


def open(name: str | Path, *, data_dir: Path | str | None = None) -> Sequence:
    """Read a recording as it stands; nothing is repaired.

    Parameters
    ----------
    name : str or Path
        A file in one of the formats that are told by their content, looked for where a config's is: a course
        file (``.npz``, ``.npy``), tracks (``.npz``) or a set of Clement et al. (``.mat``).
    data_dir : Path or str, optional
        First folder to look in.

    Raises
    ------
    DataError
        If it is not found, or not one.
    """
    from vislam.base.errors import DataError  # noqa: PLC0415
    from vislam.datasets.recording import Opening  # noqa: PLC0415
    from vislam.datasets.registry import read, source_of  # noqa: PLC0415

    folders = [Path(), *search_path(None if data_dir is None else Path(data_dir))]
    path = find_file(str(name), folders)
    if path is None:
        raise DataError(not_found(str(name), folders))
    source = source_of(path)
    return read(source.format, source, Opening(folders)).sequence
