"""YAML that a stranger may have written, read as plain data of bounded size.

What a config needs is read: mappings with text for keys, lists, text, numbers, truth values and nothing. What
PyYAML takes besides, in silence or for hours, is an error.
"""

import re
from typing import Any, NoReturn

import yaml

from vislam.base.legible import one_line, quoted

DEEPEST = 32
"""Levels of a tree."""
MOST_NODES = 20_000
"""Keys and values of a tree; what an alias stands for counts each time."""
MOST_CHARACTERS = 1 << 18
"""Length of a text."""
_MOST_DIGITS = 100
_FIRST_TOO_LARGE = 1 << 63
_NOT_IN_FILES = re.compile("[\0\ud800-\udfff]")
"""Letters that neither a path nor a file in UTF-8 can hold."""
_TAG = "tag:yaml.org,2002:"
_MERGE = f"{_TAG}merge"
_TRUTH = {"yes": True, "true": True, "on": True, "no": False, "false": False, "off": False}


def parse_yaml(text: str) -> Any:
    """Read a YAML document as plain data; nothing in it is shared.

    Raises
    ------
    ValueError
        If it is none, or not what a config can hold; one line says what, and in which line of the text.
    """
    if len(text) > MOST_CHARACTERS:
        raise ValueError(f"expected at most {MOST_CHARACTERS} characters, got {len(text)}")
    try:
        loader = _Bounded(text)
        node = loader.get_single_node()
        return None if node is None else _plain(node)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = "" if mark is None else f", line {mark.line + 1}"
        said = ", ".join(part for part in (error.context, error.problem) if part)
        raise ValueError(one_line(f"{said}{where}", limit=300)) from None
    except yaml.YAMLError as error:
        raise ValueError(one_line(str(error).partition("\n")[0], limit=300)) from None


def unwritable(value: Any, *, levels: int = DEEPEST) -> tuple[tuple[str, ...], str] | None:
    """Where plain data holds what cannot be written as YAML, and what is wrong there; None: nowhere."""
    if isinstance(value, dict | list | tuple):
        if not levels:
            return (), f"expected at most {DEEPEST} levels, got more"
        for key, item in value.items() if isinstance(value, dict) else enumerate(value):
            wrong = unwritable(key, levels=1) or unwritable(item, levels=levels - 1)
            if wrong is not None:
                return (quoted(key) if not isinstance(key, str) else one_line(key), *wrong[0]), wrong[1]
    if isinstance(value, int) and abs(value) >= _FIRST_TOO_LARGE:
        return (), f"expected a whole number below 2^63, got one of {value.bit_length()} bits"
    if isinstance(value, str) and _NOT_IN_FILES.search(value):
        return (), "expected letters that a file can hold, got NUL or half of a letter"
    return None


def _refuse(problem: str, node: yaml.Node | yaml.Event) -> NoReturn:
    raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)  # type: ignore[arg-type]


class _Bounded(yaml.SafeLoader):
    """Composes nodes as long as they are few and not deep."""

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._sizes: list[int] = []
        """Of the nodes that are being composed, from the root on."""
        self._heights: list[int] = []
        self._whole: dict[int, tuple[int, int]] = {}
        """Size and height of each node that is whole, by its identity."""

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        """Compose a node, counted for the one that it stands in."""
        event = self.peek_event()  # type: ignore[no-untyped-call]
        if isinstance(event, yaml.AliasEvent):
            node = super().compose_node(parent, index)
            if id(node) not in self._whole:
                _refuse("an alias stands inside of what it stands for", event)
        else:
            self._sizes.append(1)
            self._heights.append(1)
            self._refuse_large(event)
            node = super().compose_node(parent, index)
            self._whole[id(node)] = self._sizes.pop(), self._heights.pop()
        if self._sizes:
            size, height = self._whole[id(node)]
            self._sizes[-1] += size
            self._heights[-1] = max(self._heights[-1], height + 1)
            self._refuse_large(event)
        return node

    def _refuse_large(self, event: yaml.Event) -> None:
        """Reject a tree that has grown beyond what a config can be."""
        if len(self._heights) - 1 + self._heights[-1] > DEEPEST:
            _refuse(f"expected at most {DEEPEST} levels, got more", event)
        if sum(self._sizes) > MOST_NODES:
            _refuse(f"expected at most {MOST_NODES} keys and values, got more", event)


def _plain(node: yaml.Node) -> Any:
    kind = node.tag.removeprefix(_TAG)
    if isinstance(node, yaml.MappingNode) and kind == "map":
        return _mapping(node)
    if isinstance(node, yaml.SequenceNode) and kind == "seq":
        return [_plain(item) for item in node.value]
    if isinstance(node, yaml.ScalarNode):
        return _scalar(node, kind)
    _refuse(f"{quoted(node.tag)} is no kind of value that a config has", node)


def _mapping(node: yaml.MappingNode) -> dict[str, Any]:
    """Keys and values; those that it merges come first, and go under its own."""
    own: dict[str, Any] = {}
    merged: dict[str, Any] = {}
    for key, value in node.value:
        if key.tag == _MERGE:
            sources = value.value if isinstance(value, yaml.SequenceNode) else [value]
            for source in sources:
                if not isinstance(source, yaml.MappingNode):
                    _refuse("expected a mapping, or a list of them, behind <<", source)
                merged = {**_mapping(source), **merged}
            continue
        name = _plain(key)
        if not isinstance(name, str):
            _refuse(f"expected text for a key, got {quoted(name)}", key)
        if name in own:
            _refuse(f"the key {quoted(name)} is there twice", key)
        own[name] = _plain(value)
    return {**merged, **own}


def _scalar(node: yaml.ScalarNode, kind: str) -> Any:
    text: str = node.value
    if _NOT_IN_FILES.search(text):
        _refuse("expected letters that a file can hold, got NUL or half of a letter", node)
    # Dates and "=" are nothing but text here.
    if kind in ("str", "timestamp", "value"):
        return text
    if kind == "null":
        return None
    if kind == "bool" and text.lower() in _TRUTH:
        return _TRUTH[text.lower()]
    if kind in ("int", "float"):
        return _number(node, kind)
    _refuse(f"{quoted(text)} is no value of the kind {quoted(node.tag)}", node)


def _number(node: yaml.ScalarNode, kind: str) -> int | float:
    text: str = node.value
    if len(text) > _MOST_DIGITS:
        _refuse(f"expected a number of at most {_MOST_DIGITS} digits, got {len(text)}", node)
    reader = yaml.constructor.SafeConstructor()
    try:
        if kind == "float":
            return reader.construct_yaml_float(node)
        number = reader.construct_yaml_int(node)
    except (ValueError, IndexError):
        _refuse(f"expected a number, got {quoted(text)}", node)
    if abs(number) >= _FIRST_TOO_LARGE:
        _refuse(f"expected a whole number below 2^63, got {text}", node)
    return number
