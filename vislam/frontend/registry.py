"""Front ends by name: ours, and those of other packages by entry points in the group ``vislam.frontends``."""

import hashlib
import os
import re
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from functools import lru_cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from inspect import signature
from pathlib import Path
from typing import Any

from vislam.base.errors import ConfigError
from vislam.base.settings import parse
from vislam.core.estimator import annotation_of
from vislam.core.images import ImageRecording
from vislam.frontend.settings import ReadingConfig

GROUP = "vislam.frontends"
"""Entry-point group under which front ends of other packages are found by name."""
OWN = {"klt": "vislam.frontend.tracker:build"}
"""Front ends that come along; no other package takes their names."""
DEFAULT = "klt"


@dataclass(frozen=True)
class Chosen:
    """A front end with its settings.

    Attributes
    ----------
    name : str
    reading : ReadingConfig
        What is done with images and tracks whichever front end it is.
    settings : dict
        All settings, as the summary has them.
    origin : str
        Where it comes from, and a hash of its source: with the settings, what its tracks depend on.
    build : callable
        Makes it of a recording; of two parameters, the second is ``reading`` and is not looked at.
    """

    name: str
    reading: ReadingConfig
    settings: dict[str, Any]
    origin: str
    build: Callable[[ImageRecording, Any], Any] = field(repr=False, compare=False)


@lru_cache(maxsize=8)
def _installed(path: tuple[str, ...]) -> dict[str, EntryPoint]:
    own = {name: EntryPoint(name, value, GROUP) for name, value in OWN.items()}
    return {entry.name: entry for entry in entry_points(group=GROUP)} | own


def choose_front_end(name: str = DEFAULT, given: dict[str, Any] | None = None) -> Chosen:
    """Find a front end by its name, or by its module, ``my_module:build``, and parse its settings.

    Its builder takes the recording, and, if it has a second parameter, its options: parsed into the dataclass
    that this is annotated with, or a plain mapping. Settings of :class:`ReadingConfig` are for all of them.

    Raises
    ------
    ConfigError
        If there is none of that name, it cannot be imported, or a setting is not one of its own.
    """
    given = dict(given or {})
    known = dict(_installed(tuple(sys.path)))
    if re.fullmatch(r"[\w.]+:[\w.]+", name) and name not in known:
        known[name] = EntryPoint(name, name, GROUP)
    if name not in known:
        raise ConfigError(f"--front-end {name}: no such front end; installed are {', '.join(sorted(known))}")
    builder = _loaded(known[name])
    takes = list(signature(builder).parameters.values())
    kind = annotation_of(builder, takes[1].name) if len(takes) > 1 else None
    origin = _origin(known[name])
    if isinstance(kind, type) and issubclass(kind, ReadingConfig):
        config = parse(kind, given, at="--set")
        return Chosen(name, config, asdict(config), origin, lambda recording, _: builder(recording, config))
    common = {item.name for item in fields(ReadingConfig)}
    reading = parse(ReadingConfig, {key: given.pop(key) for key in common & given.keys()}, at="--set")
    options = _options(kind, given, takes=len(takes), name=name)
    told = asdict(options) if is_dataclass(options) and not isinstance(options, type) else given
    arguments = () if options is None else (options,)
    return Chosen(
        name,
        reading,
        {**asdict(reading), **told},
        origin,
        lambda recording, _: builder(recording, *arguments),
    )


def _options(kind: Any, given: dict[str, Any], *, takes: int, name: str) -> Any:
    """Options of a front end of somebody else; None if it takes none."""
    if takes > 1:
        if not (isinstance(kind, type) and is_dataclass(kind)):
            return given
        names = [item.name for item in fields(kind)]
        for key in given:
            if key not in names:
                raise ConfigError(f"--set.{key}: unknown key; known are {', '.join(names)}")
        return parse(kind, given, at="--set")
    if given:
        raise ConfigError(f"--set: {name} takes no settings of its own, got {', '.join(given)}")
    return None


def _loaded(entry: EntryPoint) -> Callable[..., Any]:
    here = os.getcwd()
    if here not in sys.path:
        # As ``python -m`` has it, so that the installed command finds a module of this folder, too.
        sys.path.append(here)
    try:
        builder = entry.load()
    except (ImportError, AttributeError) as error:
        raise ConfigError(f"--front-end {entry.name}: cannot be imported ({error})") from None
    if not callable(builder):
        raise ConfigError(f"--front-end {entry.name}: must be a function or class, got {builder!r}")
    return builder


def _origin(entry: EntryPoint) -> str:
    """The module, the version of its package, and a hash of its source."""
    version = "" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"
    file = getattr(import_module(entry.module), "__file__", None)
    source = b"" if file is None else Path(file).read_bytes()
    return f"{entry.value} {version} {hashlib.sha256(source).hexdigest()}"
