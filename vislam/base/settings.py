"""Settings of every room: YAML files merged, parsed into frozen dataclasses, and written.

What can be set stands beside what it sets; here is what they have in common.
"""

import os
import re
from dataclasses import MISSING, asdict
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_args

import yaml
from pydantic import Field, TypeAdapter, ValidationError

from vislam.base.errors import ConfigError, first_line
from vislam.base.files import open_regular
from vislam.base.former import renamed, renamed_path
from vislam.base.legible import one_line, quoted
from vislam.base.shipped import find_config
from vislam.base.yaml_text import DEEPEST, parse_yaml, unwritable

Parsed = TypeVar("Parsed")

LONGEST_NAME = 128
"""Letters of a name."""
_WHOLE = ("estimators", "ablation_chain")
"""Sections in which the order matters: a config that extends another replaces them."""
OTHER = "other"
"""Tag of the section, of several, that has no fixed ``format``."""
_MOST_BYTES = 1 << 18
_MOST_FILES = 16
"""Files that build on each other."""

Title = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME)]
Remark = Annotated[str, Field(max_length=1000)]


def read(path: Path, *, above: tuple[Path, ...] = ()) -> dict[str, Any]:
    """Read a configuration file, merged with those it extends, as plain data.

    ``above`` are files that build on it. A ConfigError says what is wrong with it.
    """
    tree = renamed(_read_one(path), str(path))
    base = tree.pop("extends", None)
    if base is None:
        return tree
    if not isinstance(base, str):
        raise ConfigError(f"{path}: extends: expected a file name, got {quoted(base)}")
    if path.resolve() in above:
        raise ConfigError(f"{path}: extends: the files build on each other in a circle")
    if len(above) >= _MOST_FILES:
        raise ConfigError(f"{path}: extends: more than {_MOST_FILES} files build on each other")
    below = path.parent / base
    # A copy of a shipped config builds on what is shipped beside it.
    below = below if os.path.lexists(below) else find_config(base) or below
    return _over(read(below, above=(*above, path.resolve())), tree)


def _over(base: dict[str, Any], own: dict[str, Any]) -> dict[str, Any]:
    """Merge one tree into another; its values take precedence."""
    merged = dict(base)
    for key, value in own.items():
        inside = isinstance(value, dict) and isinstance(merged.get(key), dict) and key not in _WHOLE
        merged[key] = _over(merged[key], value) if inside else value
    return merged


def _read_one(path: Path) -> dict[str, Any]:
    try:
        with open_regular(path) as file:
            content = file.read(_MOST_BYTES + 1)
        if len(content) > _MOST_BYTES:
            raise ValueError(f"expected at most {_MOST_BYTES} bytes, got more")
        tree = parse_yaml(content.decode("utf-8"))
    except OSError as error:
        raise ConfigError(one_line(f"{path}: cannot be read ({first_line(error)})")) from None
    except ValueError as error:
        raise ConfigError(one_line(f"{path}: not a YAML file ({first_line(error)})")) from None
    if not isinstance(tree, dict):
        raise ConfigError(f"{path}: expected a mapping of keys, got {type(tree).__name__}")
    return tree


def parse(kind: type[Parsed], tree: Any, *, at: str = "") -> Parsed:
    """Turn plain data into a dataclass; a ConfigError names the dotted path, what is wrong and what came."""
    if (wrong := unwritable(tree)) is not None:
        where = one_line(".".join([*([at] if at else []), *wrong[0]]) or "config", limit=200)
        raise ConfigError(f"{where}: {wrong[1]}")
    try:
        return TypeAdapter(kind).validate_python(tree)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join([*([at] if at else []), *_keys(kind, first["loc"])])
        where = one_line(where or "config", limit=200)
        if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
            raise ConfigError(f"{where}: unknown key; {_known(kind, first['loc'])}") from None
        message = one_line(re.sub(r"^Value error, ", "", first["msg"]), limit=500)
        got = "" if isinstance(first["input"], dict) else f", got {quoted(first['input'])}"
        raise ConfigError(f"{where}: {message}{got}") from None


def dump(config: Any) -> str:
    """YAML of the effective configuration, defaults filled in."""
    return yaml.safe_dump(_plain(asdict(config)), sort_keys=False)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    return [_plain(item) for item in value] if isinstance(value, list | tuple) else value


def _keys(kind: Any, location: tuple[int | str, ...]) -> list[str]:
    """Keys of a location, without the tags that say which of several sections a key is of."""
    out: list[str] = []
    inside: list[Any] = []
    for part in location:
        if len(inside) > 1 and part in map(_tag, inside):
            kind, inside = next(one for one in inside if _tag(one) == part), []
            continue
        out.append(str(part))
        known = getattr(kind, "__dataclass_fields__", {})
        if part in known:
            inside = _sections(known[part].type)
            kind = inside[0] if inside else kind
    return out


def _known(kind: Any, location: tuple[int | str, ...]) -> str:
    """List the keys that the section of an unknown key has."""
    inside = [kind]
    for part in location[:-1]:
        if isinstance(part, int):
            # An item of a list, whose section the list has already named.
            continue
        known = kind.__dataclass_fields__
        if part in known:
            inside = _sections(known[part].type)
            kind = inside[0] if inside else kind
        else:
            # The tag that says which of several sections it is.
            kind = next((one for one in inside if _tag(one) == part), kind)
    return "known are " + ", ".join(sorted(kind.__dataclass_fields__))


def _sections(annotation: Any) -> list[Any]:
    """Config sections that an annotation holds, in order."""
    if hasattr(annotation, "__dataclass_fields__"):
        return [annotation]
    return [found for part in get_args(annotation) for found in _sections(part)]


def _tag(section: Any) -> Any:
    """Value by which one section of several is chosen, as a rule its ``format``."""
    item = section.__dataclass_fields__.get("format")
    return None if item is None else OTHER if item.default is MISSING else item.default


def inline(value: Any) -> str:
    """One line of YAML."""
    return yaml.safe_dump(_plain(value), default_flow_style=True).splitlines()[0]


def put(tree: dict[str, Any], dotted: str, value: Any) -> None:
    """Set a value of a tree of plain data by its dotted path; ConfigError if that leads nowhere."""
    *parents, last = renamed_path(dotted).split(".")
    if not all((*parents, last)) or len(parents) >= DEEPEST:
        raise ConfigError(f"{quoted(dotted)}: expected a key, or keys joined by single dots")
    for part in parents:
        if tree.get(part) is None or tree[part] is True:
            # A section that is left empty, or a step that is switched on with its defaults.
            tree[part] = {}
        tree = tree[part]
        if not isinstance(tree, dict):
            where = one_line(dotted, limit=200)
            raise ConfigError(f"{where}: {quoted(part)} is a value and has no keys below it")
    tree[last] = value
