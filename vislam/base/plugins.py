"""Plugins by name: entry points of a group, or what a module has, ``my_module:build``."""

import re
import sys
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_type_hints

from vislam.base.errors import ConfigError
from vislam.base.settings import parse

_NONE: Mapping[str, str] = {}


def installed(group: str, own: Mapping[str, str] = _NONE) -> dict[str, EntryPoint]:
    """Entry points of a group by name.

    Parameters
    ----------
    group : str
    own : mapping of str to str
        Those that come along, by name, ``module:object``; no other package takes their names.
    """
    return _of(group, tuple(sys.path)) | {name: EntryPoint(name, value, group) for name, value in own.items()}


def find_plugin(name: str, group: str, own: Mapping[str, str] = _NONE) -> EntryPoint | None:
    """Entry point of a name, or of a module, ``my_module:build``; None if there is none."""
    known = installed(group, own)
    if name in known:
        return known[name]
    return EntryPoint(name, name, group) if re.fullmatch(r"[\w.]+:[\w.]+", name) else None


def load_plugin(entry: EntryPoint, here: str) -> Any:
    """Load an entry point; a module of the folder ``here`` is found as well."""
    if here not in sys.path:
        # As ``python -m`` has it, so that the installed command finds a module of this folder, too.
        sys.path.append(here)
    return entry.load()


def annotation_of(builder: Callable[..., Any], parameter: str) -> Any:
    """Annotation of a parameter of a function or class; None if it has none, or none that can be resolved."""
    called = vars(builder).get("__init__", builder) if isinstance(builder, type) else builder
    try:
        return get_type_hints(called).get(parameter)
    except (NameError, TypeError):
        return None


def plugin_options(kind: Any, given: Mapping[str, Any], *, at: str) -> Any:
    """Options parsed into the dataclass that a builder is annotated with; as given if it is none.

    Raises
    ------
    ConfigError
        If a key is unknown, or a value is not what it has to be; ``at`` is the section that is named.
    """
    if not (isinstance(kind, type) and is_dataclass(kind)):
        return given
    names = [item.name for item in fields(kind)]
    for name in given:
        if name not in names:
            raise ConfigError(f"{at}.{name}: unknown key; known are {', '.join(names)}")
    return parse(kind, dict(given), at=at)


@lru_cache(maxsize=24)
def _of(group: str, path: tuple[str, ...]) -> dict[str, EntryPoint]:
    """The folders of all packages are read once for each path that is searched."""
    del path
    return {entry.name: entry for entry in entry_points(group=group)}
