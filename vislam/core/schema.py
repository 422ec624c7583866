"""Schema of a saved archive: the vocabulary of its table, in which a field is one line.

A table maps the dotted path of each field to what it is; :mod:`vislam.core.archive` holds an archive to it.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from vislam.base.types import Array, BoolArray
from vislam.geometry import se3

Count = Annotated[int, Field(ge=0)]
Level = Annotated[float, Field(ge=0, le=1e30)]
Extent = Annotated[float, Field(gt=0, le=1e9)]
Coordinate = Annotated[float, Field(ge=-1e9, le=1e9)]

_ROTATION_TOLERANCE = 1e-3
"""How far R^T R may be from the identity: reference files carry seven digits."""
_LARGEST_ID = 10**7
"""Tracks are counted by their ids, so that a large one takes memory."""


@dataclass(frozen=True)
class Rule:
    """What the rows of an array must be.

    Attributes
    ----------
    expected : str
    wrong : callable
        Mask ``(n,)`` of the rows that are not, of an array ``(n, ...)``.
    """

    expected: str
    wrong: Callable[[Array], BoolArray]


@dataclass(frozen=True)
class Numbers:
    """An array.

    Attributes
    ----------
    shape : str
        Sizes and letters, as in ``"T 6"``; fields with a letter in common share its size. ``|`` stands
        between shapes of which one is to be met.
    kind : str
    rules : tuple of Rule
    gaps : bool
        Whether values that are not finite stand for what is not given, or known.
    optional : bool
        Whether null may stand in its place.
    below : str
        Letter whose size all values are below, as indices of its rows; empty for none.
    later : bool
        Whether archives of older versions lack it.
    """

    shape: str
    kind: Literal["real", "whole", "mask"]
    rules: tuple[Rule, ...] = ()
    gaps: bool = False
    optional: bool = False
    below: str = ""
    later: bool = False


@dataclass(frozen=True)
class Plain:
    """A value of JSON, of a type as pydantic checks it; archives of older versions may lack a later one."""

    type: Any
    later: bool = False


@dataclass(frozen=True)
class Section:
    """A mapping whose fields have lines of their own; if it is optional, null may stand in its place."""

    optional: bool = False
    later: bool = False


@dataclass(frozen=True)
class Each:
    """A mapping from short names to sections, all with the same arrays.

    Attributes
    ----------
    fields : mapping of str to Numbers
        ``*`` in a shape is a size that the arrays of one section have in common.
    """

    fields: Mapping[str, Numbers]

    def expanded(self, dotted: str, names: Iterable[str]) -> "Iterator[tuple[str, Item]]":
        """Lines of a table for the sections of some names at a dotted path."""
        yield dotted, Section()
        for section in (f"{dotted}.{name}" for name in names):
            yield section, Section()
            for key, item in self.fields.items():
                yield f"{section}.{key}", replace(item, shape=item.shape.replace("*", section))


Item = Numbers | Plain | Section
Table = Mapping[str, Item | Each]
SHORT_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,31}")
"""What names of sections, which others choose, may be."""


def real(
    shape: str, *rules: Rule, gaps: bool = False, optional: bool = False, later: bool = False
) -> Numbers:
    """Array of real numbers."""
    return Numbers(shape, "real", rules, gaps, optional, later=later)


def whole(shape: str, *rules: Rule, below: str = "") -> Numbers:
    """Array of whole numbers."""
    return Numbers(shape, "whole", rules, below=below)


def mask(shape: str) -> Numbers:
    """Array of booleans."""
    return Numbers(shape, "mask")


def _any_of_row(wrong: BoolArray) -> BoolArray:
    return np.asarray(wrong.any(axis=tuple(range(1, wrong.ndim))))


def _repeated(values: Array) -> BoolArray:
    again = np.ones(len(values), bool)
    again[np.unique(values, return_index=True)[1]] = False
    return again


def _not_rigid(pose: Array) -> BoolArray:
    rigid = se3.is_rigid(pose.reshape(-1, 4, 4), tolerance=_ROTATION_TOLERANCE)
    return np.asarray(~rigid.reshape(pose.shape[:-2] or (1,)))


def _no_direction(vector: Array) -> BoolArray:
    return np.full(len(vector), abs(np.linalg.norm(vector) - 1.0) > _ROTATION_TOLERANCE)


INCREASING = Rule("increasing", lambda values: np.diff(values, prepend=values[:1] - 1) <= 0)
SORTED = Rule("in order", lambda values: np.diff(values, prepend=values[:1]) < 0)
NOT_NEGATIVE = Rule("not negative", lambda values: _any_of_row(values < 0))
POSITIVE = Rule("positive", lambda values: _any_of_row(values <= 0))
UNIQUE = Rule("without repetitions", _repeated)
IDS = Rule(f"ids from 0 to {_LARGEST_ID:g}", lambda values: (values < 0) | (values > _LARGEST_ID))
RIGID = Rule("rigid transforms (rotation, determinant +1, last row 0 0 0 1)", _not_rigid)
DIRECTION = Rule("a direction of length 1", _no_direction)
