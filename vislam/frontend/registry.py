"""Front ends by name: ours, and those of other packages by entry points in the group ``vislam.frontends``."""

import hashlib
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, fields, is_dataclass
from importlib import import_module
from importlib.metadata import EntryPoint
from inspect import signature
from pathlib import Path
from typing import Any

from vislam.base.errors import ConfigError
from vislam.base.plugins import annotation_of, find_plugin, installed, load_plugin, plugin_options
from vislam.base.settings import parse
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
    entry = find_plugin(name, GROUP, OWN)
    if entry is None:
        known = ", ".join(sorted(installed(GROUP, OWN)))
        raise ConfigError(f"--front-end {name}: no such front end; installed are {known}")
    builder = _loaded(entry)
    takes = list(signature(builder).parameters.values())
    kind = annotation_of(builder, takes[1].name) if len(takes) > 1 else None
    origin = _origin(entry)
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
        return plugin_options(kind, given, at="--set")
    if given:
        raise ConfigError(f"--set: {name} takes no settings of its own, got {', '.join(given)}")
    return None


def _loaded(entry: EntryPoint) -> Callable[..., Any]:
    try:
        builder = load_plugin(entry, os.getcwd())
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
