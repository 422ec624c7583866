"""Saved archives of dataclasses: fields under dotted names, read back as a table has them, one by one.

Every header is checked before memory is taken, so that a small file cannot claim a large array; nothing is
unpickled.
"""

import json
import math
import re
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter, ValidationError

from vislam.base.errors import DataError, first_line
from vislam.base.files import PLAIN, save_archive
from vislam.base.legible import brief
from vislam.base.npy import ArrayError, PackedArray, open_array
from vislam.base.types import Array, BoolArray
from vislam.core.schema import SHORT_NAME, Each, Item, Numbers, Plain, Section, Table

Tree = dict[str, Any]

_LARGEST = {"real": 1e30, "whole": 10**12, "mask": 1}
"""Largest numbers: products of larger real ones overflow, sums of larger whole ones are not exact."""
_MOST_BYTES = 1 << 30
"""All arrays of an archive, unpacked; ten thousand frames with a million observations have a tenth."""
_MOST_ROWS = 10**7
"""Frames, observations or landmarks, at most."""
_LARGEST_INTEGER = 2**53
"""Largest whole number of the plain data: it is still a float as well."""
_MOST_TEXT = 1 << 24
"""Bytes of an archive's plain data."""
_DEEPEST = 10
"""How deeply it may be nested."""
_STORED = re.compile(r"[<>|=](f[248]|[iu][1248]|b1|U\d{1,9})")
_CODES = {"real": "fiu", "whole": "iu", "mask": "b"}
_TYPES = {"real": np.float64, "whole": np.int64, "mask": np.bool_}
_WORDS = {"real": "real numbers", "whole": "whole numbers", "mask": "booleans"}
_BROKEN = (EOFError, ValueError, RuntimeError, zipfile.BadZipFile, zlib.error)
"""What reading a damaged archive raises, as a member that is encrypted or that ends early."""
_MISSING, _BELOW_NULL = object(), object()
_NO_NAMES: Mapping[str, str] = {}


def write_archive(path: Path, value: Any) -> None:
    """Write a dataclass as one file, whole or not at all: its arrays, those of its parts, and plain data."""
    arrays: dict[str, Array] = {}
    plain = _taken_apart(value, arrays, at="")
    save_archive(path, plain, arrays)


def _taken_apart(value: Any, arrays: dict[str, Array], *, at: str) -> Any:
    """Plain data of a tree of dataclasses; its arrays go to ``arrays`` by their dotted path."""
    if isinstance(value, np.ndarray):
        arrays[at] = value
        return {"array": at}
    if is_dataclass(value):
        value = {item.name: getattr(value, item.name) for item in fields(value)}
    below = f"{at}." if at else ""
    if isinstance(value, dict):
        return {key: _taken_apart(item, arrays, at=f"{below}{key}") for key, item in value.items()}
    if isinstance(value, tuple):
        return [_taken_apart(item, arrays, at=f"{below}{index}") for index, item in enumerate(value)]
    return value


class _Wrong(Exception):
    """What came in place of what was expected, in words."""


def read_archive(path: Path, table: Table, *, what: str, former: Mapping[str, str] = _NO_NAMES) -> Tree:
    """Fields of an archive that :func:`vislam.base.files.save_archive` wrote, checked against a table.

    Parameters
    ----------
    path : Path
    table : Table
    what : str
        What the archive should be, for the error.
    former : mapping of str to str
        Dotted names of fields and sections that an older version wrote, and what they are called now.

    Returns
    -------
    dict
        Values by their names; those of a section, or None, below its name. What an older version did not
        write is left out.

    Raises
    ------
    DataError
        If it is none, or a field is missing, unknown, or not as the table has it.
    """
    try:
        if not path.exists():
            raise _Wrong("no such file")
        if not path.is_file():
            raise _Wrong("no regular file")
        with zipfile.ZipFile(path) as archive:
            return _Reader(archive, table, former).tree()
    except _Wrong as wrong:
        text = str(wrong)
    except OSError as error:
        text = f"none that can be read ({brief(first_line(error))})"
    except _BROKEN as error:
        text = f"no whole archive ({brief(first_line(error))})"
    raise DataError(f"{path}: expected {what}, got {text}; run the comparison again") from None


class _Reader:
    def __init__(self, archive: zipfile.ZipFile, table: Table, former: Mapping[str, str]) -> None:
        self._archive, self._written, self._former = archive, table, former
        self._table: dict[str, Item] = {}
        written = [name.removesuffix(".npy") for name in archive.namelist()]
        self._names = [_renamed(name, former) for name in written]
        # Name of each array in the archive, by that of its field.
        self._stored = dict(zip(self._names, written, strict=True))
        # Size of each letter, and the field that has set it.
        self._sizes: dict[str, tuple[int, str]] = {}

    def tree(self) -> Tree:
        plain = self._plain()
        self._table = dict(_expanded(self._written, plain))
        self._refuse_unknown(plain)
        values, packed = Tree(), dict[str, PackedArray]()
        absent: tuple[str, ...] = ()
        for name, item in self._table.items():
            found = _look_up(plain, name)
            if found is _BELOW_NULL or name.startswith(absent):
                continue
            if found is _MISSING and isinstance(item, Section) and item.later:
                # Of a section that an older version did not write there are no fields either.
                absent = (*absent, f"{name}.")
                continue
            if isinstance(item, Numbers) and name in self._names and found in (_MISSING, {"array": name}):
                packed[name] = self._header(name, item)
            elif found is not _MISSING:
                values[name] = _value(name, item, found)
            elif not item.later:
                raise _Wrong(f"no '{name}'")
        if (total := sum(array.size * array.dtype.itemsize for array in packed.values())) > _MOST_BYTES:
            raise _Wrong(f"{total:.2g} bytes of arrays, of which {_MOST_BYTES:.2g} are the most")
        for name, array in packed.items():
            values[name] = self._array(name, array)
        return _nested(self._table, values)

    def _plain(self) -> Tree:
        if len(set(self._names)) < len(self._names):
            raise _Wrong("an archive with two members of one name")
        packed = self._open(PLAIN)
        if packed.dtype.kind != "U" or packed.shape or packed.dtype.itemsize > _MOST_TEXT:
            raise _Wrong(f"plain data of type {packed.dtype} and shape {packed.shape}")
        with packed.stream:
            text = str(np.concatenate(list(packed.chunks()))[0])
        try:
            tree = json.loads(
                text, object_pairs_hook=_once, parse_constant=_number, parse_float=_number, parse_int=_whole
            )
        except RecursionError:
            raise _Wrong("plain data that is nested too deeply") from None
        if not isinstance(tree, dict):
            raise _Wrong(f"plain data that is {_kind_of(tree)}")
        if _deeper(tree, _DEEPEST):
            raise _Wrong("plain data that is nested too deeply")
        return _tree_renamed(tree, self._former, at="") if self._former else tree

    def _refuse_unknown(self, plain: Tree) -> None:
        sections = [name for name, item in self._table.items() if isinstance(item, Section)]
        below = [f"{name}.{key}" for name in sections for key in _children(_look_up(plain, name), keys=True)]
        for name in [*plain, *below, *self._names]:
            if name not in self._table and name != PLAIN:
                raise _Wrong(f"an unknown field '{brief(name)}'")

    def _open(self, name: str) -> PackedArray:
        try:
            return open_array(
                self._archive, f"{self._stored.get(name, name)}.npy", stored=_STORED, what="numbers"
            )
        except KeyError:
            raise _Wrong(f"no '{name}'") from None
        except ArrayError as error:
            raise _Wrong(f"'{name}', which {brief(str(error))}") from None

    def _header(self, name: str, item: Numbers) -> PackedArray:
        """Open an array whose type and shape are right."""
        packed = self._open(name)
        if packed.dtype.kind not in _CODES[item.kind]:
            raise _Wrong(f"'{name}', which must be {_WORDS[item.kind]}, as {packed.dtype}")
        if max(packed.shape, default=0) > _MOST_ROWS:
            raise _Wrong(f"'{name}' of shape {packed.shape}, which may have {_MOST_ROWS:g} rows at most")
        if not any(self._fits(packed.shape, shape.split(), name) for shape in item.shape.split("|")):
            letters = dict.fromkeys(part for part in item.shape.split() if part in self._sizes)
            sizes = [f"{part} = {self._sizes[part][0]} as in '{self._sizes[part][1]}'" for part in letters]
            given = f" with {', '.join(sizes)}" if sizes else ""
            raise _Wrong(f"'{name}', which must be of shape ({item.shape}){given}, of shape {packed.shape}")
        return packed

    def _fits(self, got: tuple[int, ...], wanted: list[str], name: str) -> bool:
        """Whether a shape is as wanted; letters that are new are then bound to its sizes."""
        bound = dict(self._sizes)
        for size, part in zip(got, wanted, strict=False):
            expected = int(part) if part.isdigit() else bound.setdefault(part, (size, name))[0]
            if size != expected:
                return False
        if len(got) != len(wanted):
            return False
        self._sizes = bound
        return True

    def _array(self, name: str, packed: PackedArray) -> Any:
        """Read an array; _Wrong if some of its values cannot be right."""
        item = self._table[name]
        assert isinstance(item, Numbers)
        with packed.stream:
            flat = np.concatenate([np.empty(0, packed.dtype), *packed.chunks()])
        # A byte that is neither 0 nor 1 would be no boolean.
        raw = flat.view(np.uint8) if item.kind == "mask" else flat
        values: Any = raw.astype(_TYPES[item.kind], copy=False)
        values = values.reshape(packed.shape, order="F" if packed.fortran else "C")
        largest = _LARGEST[item.kind]
        wrong = ~((values >= -largest) & (values <= largest))
        wrong = wrong & np.isfinite(values) if item.gaps else wrong
        _refuse(name, values, wrong, f"numbers up to {largest:g}")
        if item.below:
            size, of = self._sizes[item.below]
            _refuse(name, values, values >= size, f"below {size}, the length of '{of}'")
        for rule in item.rules:
            _refuse(name, values, rule.wrong(values), rule.expected)
        return values


def _renamed(name: str, former: Mapping[str, str]) -> str:
    """Dotted name of a field by its new name, or that of the section it is in."""
    for old, new in former.items():
        if name == old or name.startswith(f"{old}."):
            return new + name.removeprefix(old)
    return name


def _tree_renamed(tree: Tree, former: Mapping[str, str], *, at: str) -> Tree:
    """Plain data, and the references to arrays in them, by the new names of fields."""
    out = Tree()
    for key, value in tree.items():
        name = f"{at}{key}"
        inner = value
        if isinstance(value, dict) and value.keys() == {"array"}:
            inner = {"array": _renamed(str(value["array"]), former)}
        elif isinstance(value, dict):
            inner = _tree_renamed(value, former, at=f"{name}.")
        out[former[name].rpartition(".")[2] if name in former else key] = inner
    return out


def _expanded(table: Table, plain: Tree) -> Iterator[tuple[str, Item]]:
    """Lines of a table, with those of the sections whose names plain data give."""
    for name, item in table.items():
        if not isinstance(item, Each):
            yield name, item
            continue
        keys = [str(key) for key in _children(_look_up(plain, name), keys=True)]
        for key in keys:
            if not SHORT_NAME.fullmatch(key):
                raise _Wrong(f"'{name}' with the name '{brief(key)}'")
        yield from item.expanded(name, keys)


def _look_up(plain: Tree, dotted: str) -> Any:
    """Value at a dotted path; whether it is missing, or in a section that is null."""
    value: Any = plain
    for part in dotted.split("."):
        if value is None:
            return _BELOW_NULL
        if not isinstance(value, dict) or part not in value:
            return _MISSING
        value = value[part]
    return value


def _value(name: str, item: Item, value: Any) -> Any:
    """Value of a field that is not in an array of its own."""
    if isinstance(item, Plain):
        return _parsed(name, item, value)
    if isinstance(item, Section) and isinstance(value, dict):
        return {}
    if item.optional and value is None:
        return None
    kind = f"an array of {_WORDS[item.kind]}" if isinstance(item, Numbers) else "a mapping"
    raise _Wrong(f"'{name}', which must be {kind}, as {_kind_of(value)}")


def _parsed(name: str, item: Plain, value: Any) -> Any:
    try:
        # JSON has no tuples: only where it reads JSON does pydantic, when it is strict, make them of lists.
        return _adapter(item.type).validate_json(json.dumps(value), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False)[0]
        where = ".".join([name, *(str(part) for part in first["loc"])])
        raise _Wrong(f"'{brief(where)}' in {brief(repr(value))}: {brief(first['msg'])}") from None


@cache
def _adapter(annotation: Any) -> TypeAdapter[Any]:
    return TypeAdapter(annotation)


def _nested(table: Table, values: Tree) -> Tree:
    """Values by their names, those of sections in dictionaries of their own."""
    tree = Tree()
    for name in table:
        if name in values:
            *sections, last = name.split(".")
            inside = tree
            for section in sections:
                inside = inside[section]
            inside[last] = values[name]
    return tree


def _refuse(name: str, values: Any, wrong: BoolArray, expected: str) -> None:
    """Raise _Wrong at the first place of a mask of the values, or of their rows."""
    if wrong.any():
        first = tuple(int(index[0]) for index in np.nonzero(wrong))
        got = np.array2string(values[first], separator=", ", threshold=6, edgeitems=2)
        raise _Wrong(f"'{name}', which must be {expected}, with {brief(' '.join(got.split()))} at {first}")


def _children(value: Any, *, keys: bool = False) -> Iterable[Any]:
    """Values of a mapping, or its keys, or items of a list; of anything else, none."""
    if isinstance(value, dict):
        return value.keys() if keys else value.values()
    return value if isinstance(value, list) and not keys else ()


def _deeper(tree: Tree, most: int) -> bool:
    """Whether plain data is nested more deeply than that."""
    level: list[Any] = [tree]
    for _ in range(most):
        level = [child for value in level for child in _children(value)]
    return bool(level)


def _once(pairs: list[tuple[str, Any]]) -> Tree:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise _Wrong("plain data with a key that stands twice")
    return found


def _number(text: str) -> float:
    if not math.isfinite(number := float(text)):
        raise _Wrong(f"plain data with {brief(text)} in place of a finite number")
    return number


def _whole(text: str) -> int:
    if abs(number := _number(text)) > _LARGEST_INTEGER:
        raise _Wrong(f"plain data with the whole number {number:.3g}")
    return int(text)


def _kind_of(value: Any) -> str:
    return "null" if value is None else f"{type(value).__name__} {brief(repr(value))}"
