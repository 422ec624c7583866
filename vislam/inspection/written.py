"""The config that an inspection writes: what was found and measured, and marks at what was not."""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from vislam.base.legible import one_line
from vislam.comparison import config as configuration
from vislam.comparison.config import ORDINARY, Config
from vislam.datasets.find import find_path
from vislam.inspection.finding import Inspection

_FILES = (
    ("data", "file"),
    ("data", "source", "file"),
    ("data", "reference", "file"),
    ("data", "inertial", "folder"),
    ("data", "inertial", "camera_timestamps"),
    ("data", "simulation", "recorded", "file"),
)
"""Where a config names files."""
_LONGEST = 400
"""So much of a reason goes into a comment."""


def proposed_config(
    tree: Mapping[str, Any], result: Inspection, *, folders: list[Path], written_to: Path
) -> str:
    """Text of a config that runs as written, from any folder.

    What answers a fault is put over what was configured; what was measured only where nothing was.

    Parameters
    ----------
    tree : mapping
        The config as it was given, without defaults.
    result : Inspection
    folders : list of Path
        Where its files are looked for.
    written_to : Path
        The file that the text is for: names of files are relative to its folder, or absolute.
    """
    changed = deepcopy(dict(tree))
    for dotted, value in result.settings.items():
        if not _given(tree, dotted):
            configuration.put(changed, dotted, value)
    for dotted, value in result.proposal.items():
        configuration.put(changed, dotted, value)
    for path in _FILES:
        _point_at(changed, path, folders, written_to.resolve().parent)
    config = configuration.parse(Config, changed)
    text = configuration.dump(config)
    marks = _considered(config) | {dotted: f"unknown: {reason}" for dotted, reason in result.unknown.items()}
    told = [_comment(f"By python -m vislam.inspect on {result.name}, from its data alone. Its findings:")]
    told += [_comment(f"{item.verdict.upper()} {item.check}: {item.text}") for item in result.findings]
    return "\n".join([*told, *annotated(text.splitlines(), marks)]) + "\n"


def _considered(config: Config) -> dict[str, str]:
    """Mark with what all tracks may share, for a config that considers none of it."""
    if next(config.consider.components(), None) is not None:
        return {}
    wanted = replace(ORDINARY, velocity_direction=0.0) if config.motion == "imu" else ORDINARY
    named = ", ".join(f"{name}: {value:g}" for name, value in asdict(wanted).items() if value)
    runs = len(list(wanted.components()))
    told = f"covariances with what all tracks may share, by {runs} more runs of each estimator"
    return {"consider": f"{told}: {{{named}}}"}


def _given(tree: Mapping[str, Any], dotted: str) -> bool:
    """Whether a tree of plain data says anything of a dotted path."""
    here: Any = tree
    for part in dotted.split("."):
        if not isinstance(here, Mapping) or part not in here:
            return False
        here = here[part]
    return True


def _point_at(tree: dict[str, Any], path: tuple[str, ...], folders: list[Path], home: Path) -> None:
    """Let a config's file name say where the file is: below the config's folder, or absolutely."""
    here: Any = tree
    for part in path[:-1]:
        here = here.get(part) if isinstance(here, dict) else None
    if not isinstance(here, dict) or not isinstance(name := here.get(path[-1]), str):
        return
    found = find_path(name, folders)
    if found is None:
        return
    whole = found.resolve()
    here[path[-1]] = (whole.relative_to(home) if whole.is_relative_to(home) else whole).as_posix()


def annotated(lines: list[str], marks: Mapping[str, str]) -> list[str]:
    """Lines of a block-style YAML mapping with a comment above each marked dotted path.

    A path that is not there, as the options of a step that is off, has its comment above the nearest one that
    is.
    """
    paths = _paths(lines)
    known = set(paths)
    above: dict[str, list[str]] = {}
    for dotted, mark in marks.items():
        at = dotted
        while at not in known and "." in at:
            at = at.rpartition(".")[0]
        above.setdefault(at, []).append(mark if at == dotted else f"{dotted}: {mark}")
    out: list[str] = []
    for line, dotted in zip(lines, paths, strict=True):
        indent = " " * (len(line) - len(line.lstrip()))
        out += [f"{indent}{_comment(mark)}" for mark in above.pop(dotted, [])]
        out.append(line)
    return out


def _paths(lines: list[str]) -> list[str]:
    """Dotted path of the key on each line of a block-style YAML mapping; of an item, empty."""
    found: list[str] = []
    parents: list[tuple[int, str]] = []
    for line in lines:
        indent = len(line) - len(line.lstrip())
        key, colon, _ = line.strip().partition(":")
        if not colon or line.lstrip().startswith(("- ", "'", '"')):
            found.append("")
            continue
        parents = [(depth, name) for depth, name in parents if depth < indent]
        parents.append((indent, key))
        found.append(".".join(name for _, name in parents))
    return found


def _comment(text: str) -> str:
    """One line of comment, whatever is in the text."""
    return f"# {one_line(text, limit=_LONGEST)}"
