"""The points of a study and its trials: which config, which seed, and by which id both are found again."""

import hashlib
import itertools
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from typing import Any

from scipy.stats import qmc

from vislam.base.errors import ConfigError, first_line
from vislam.comparison import config as configuration
from vislam.comparison.config import Config
from vislam.comparison.identity import inputs_digest
from vislam.comparison.members import members
from vislam.datasets.find import search_path
from vislam.study.ablation import CASE, Ablation, changes
from vislam.study.settings import StudyConfig
from vislam.study.trials import hashable

_ID_DIGITS = 16
_NOT_SWEPT = ("seed", "name", "study", "checks", "blas_threads")
"""Keys that are the study's own, or mean nothing to a trial."""


@dataclass(frozen=True)
class Point:
    """A config that a study repeats over seeds.

    Attributes
    ----------
    values : dict of str to Any
        What it puts in place of the config's own, by dotted path.
    tree : dict
        The effective config as plain data, without what a trial does not look at.
    inputs : str
        Hash of the content of the files that the config names; empty if it names none.
    """

    values: dict[str, Any]
    tree: dict[str, Any]
    inputs: str = ""

    @classmethod
    def of(
        cls, config: Config, values: Mapping[str, Any], *, changes: Mapping[str, Any] | None = None
    ) -> "Point":
        """Set values of a config, or what they stand for; ConfigError if it rejects them."""
        try:
            tree = _plain(replace(config, study=None, checks=(), seed=0, blas_threads=1))
            for path, value in (values if changes is None else changes).items():
                configuration.put(tree, path, deepcopy(value))
            found = configuration.parse(Config, tree)
            members(found)
            tree = _plain(found)
        except ConfigError as error:
            raise ConfigError(f"study: {error}") from None
        return cls(dict(values), tree, inputs_digest(tree, search_path(None)))

    @property
    def label(self) -> str:
        """Its values in one line."""
        return ", ".join(f"{path} {configuration.inline(value)}" for path, value in self.values.items())

    @cached_property
    def digest(self) -> str:
        """Hash of the effective config."""
        return hashlib.sha256(json.dumps(self.tree).encode()).hexdigest()


@dataclass(frozen=True)
class Trial:
    """A point with a seed; the id is a hash of both, of the code and of the files that are read."""

    id: str
    point: Point
    seed: int


def all_points(config: Config, study: StudyConfig) -> list[Point]:
    """Points of a study; the config itself where nothing is swept.

    Raises
    ------
    ConfigError
        If the config takes one of them not, or if two of them are the same.
    """
    swept = [*study.grid, *study.around, *(study.latin_hypercube.ranges if study.latin_hypercube else {})]
    sets = [study.defects, *study.named.values()]
    for path in (*swept, *(path for each in sets for values in each.values() for path in values)):
        if path.split(".", maxsplit=1)[0] in _NOT_SWEPT:
            raise ConfigError(f"study: {path} cannot be swept")
    if study.defects:
        cases = Ablation(tuple(study.defects)).cases()
        points = [
            Point.of(config, {CASE: label}, changes=changes(study.defects, present))
            for label, present in cases.items()
        ]
    elif study.around:
        points = [Point.of(config, values) for values in _one_at_a_time(config, study.around)]
    else:
        points = [Point.of(config, values, changes=_changes(study, values)) for values in point_values(study)]
    _refuse_equal(points)
    return points


def _refuse_equal(points: Sequence[Point]) -> None:
    """Raise ConfigError if two points are one, which would be run once and counted twice.

    They are if their configs are the same, or their values cannot be told apart, as 1, 1.0 and true.
    """
    seen: dict[Any, Point] = {}
    for point in points:
        for sign in (point.digest, hashable(list(point.values.items()))):
            other = seen.setdefault(sign, point)
            if other is not point:
                raise ConfigError(
                    f"study: expected points that differ, got the same one twice ({other.label} and "
                    f"{point.label}); leave one out"
                )


def point_values(study: StudyConfig) -> Iterator[dict[str, Any]]:
    """Values of each point by dotted path or name; of a grid, the last path changes fastest."""
    cube = study.latin_hypercube
    if cube is None:
        swept: dict[str, Iterable[Any]] = {**study.named, **study.grid}
        for combination in itertools.product(*swept.values()):
            yield dict(zip(swept, combination, strict=True))
        return
    low, high = zip(*cube.ranges.values(), strict=True)
    unit = qmc.LatinHypercube(len(cube.ranges), rng=cube.seed).random(cube.samples)
    for row in qmc.scale(unit, low, high):
        yield dict(zip(cube.ranges, row.tolist(), strict=True))


def _changes(study: StudyConfig, values: Mapping[str, Any]) -> dict[str, Any]:
    """What the values of a point stand for, by dotted path."""
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= study.named[name][value] if name in study.named else {name: value}
    return found


def _one_at_a_time(config: Config, around: Mapping[str, Sequence[Any]]) -> Iterator[dict[str, Any]]:
    """The config's own values, then each of the others alone; ConfigError if one has nothing to stand for."""
    tree = _plain(config)
    own = {path: _at(tree, path) for path in around}
    yield own
    for path, values in around.items():
        for value in values:
            yield {**own, path: value}


def _at(tree: Mapping[str, Any], path: str) -> Any:
    """Value of a config by its dotted path."""
    found: Any = tree
    for part in path.split("."):
        if not isinstance(found, Mapping) or part not in found:
            raise ConfigError(
                f"study.around: expected the path of a value that the config has, got {path}; "
                "switch its section on, or leave it out"
            )
        found = found[part]
    return found


def all_trials(points: Sequence[Point], *, seeds: range, code: str, data: str = "") -> Iterator[Trial]:
    """Trials of the points, in the order of the points; ``data`` is the hash of a recording."""
    for point in points:
        for seed in seeds:
            text = "|".join([point.digest, str(seed), code, *filter(None, (data, point.inputs))])
            yield Trial(hashlib.sha256(text.encode()).hexdigest()[:_ID_DIGITS], point, seed)


def _plain(config: Config) -> dict[str, Any]:
    """Config as what JSON makes of it, so that what is sent elsewhere and what is hashed are the same."""
    try:
        return json.loads(json.dumps(asdict(config)))
    except TypeError as error:
        raise ConfigError(
            f"expected numbers, texts, lists and mappings, got another kind ({first_line(error)}); quote it"
        ) from None
