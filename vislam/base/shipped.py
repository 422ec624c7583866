"""The configs that come with the package: beside it in a checkout, inside it when it is installed."""

import os
from pathlib import Path

from vislam.base.former import CONFIGS, note

_PACKAGE = Path(__file__).parents[1]
_FOLDERS = (_PACKAGE / "configs", _PACKAGE.parent / "configs")


def shipped_configs() -> dict[str, Path]:
    """Files of the shipped configs, by their names without ``.yaml``; ``battle/kitti_0001`` in a folder."""
    folder = next((folder for folder in _FOLDERS if folder.is_dir()), None)
    if folder is None:
        return {}
    files = sorted(folder.rglob("*.yaml"))
    return {path.relative_to(folder).with_suffix("").as_posix(): path for path in files}


def find_config(name: str | Path) -> Path | None:
    """File of a config: the one named, the same with ``.yaml``, or a shipped one; None if there is none.

    ``configs/ds3.yaml`` stands for the shipped one, too, in a folder that has no such file, and so does a
    name alone for a config in a folder of them.
    """
    path = Path(name)
    for candidate in (path, path.with_name(f"{path.name}.yaml")):
        # A name that is too long, or that may not be looked at, raises with the methods of Path.
        if os.path.isfile(candidate):
            return candidate
    name = path.as_posix().removeprefix("configs/").removesuffix(".yaml")
    shipped = shipped_configs()
    if name in CONFIGS:
        note({name: CONFIGS[name]}, "config")
        name = CONFIGS[name]
    alone = {other.rpartition("/")[2]: file for other, file in shipped.items()}
    return shipped.get(name, alone.get(name))


def about(path: Path) -> str:
    """First sentence of the comment at the head of a config."""
    lines = []
    for line in path.read_text(encoding="utf-8").splitlines():
        if not line.startswith("#"):
            break
        lines.append(line.lstrip("# "))
    text = " ".join(lines)
    return text.partition(". ")[0].rstrip(".")
