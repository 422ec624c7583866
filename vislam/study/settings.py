"""What can be set of a study."""

from typing import Annotated, Any

from pydantic import BeforeValidator, Field
from pydantic.dataclasses import dataclass

from vislam.base.fields import STRICT
from vislam.base.former import metric_key
from vislam.core.run import Estimate

MetricKey = Annotated[str, BeforeValidator(metric_key)]
"""Key of a metric, as in ``metrics.json``; a former one is accepted."""
Count = Annotated[int, Field(ge=1)]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class LatinHypercube:
    """Points that fill a box evenly: each range is cut in as many parts as points, and each part has one.

    McKay, Beckman and Conover, *A comparison of three methods for selecting values of input variables in the
    analysis of output from a computer code*, Technometrics 21 (1979).
    """

    samples: Count
    """Number of points."""
    ranges: Annotated[dict[str, tuple[float, float]], Field(min_length=1)]
    """Lowest and highest value, by dotted path in the config."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the points."""

    def __post_init__(self) -> None:
        """Reject a range without a length."""
        for path, (low, high) in self.ranges.items():
            if not low < high:
                raise ValueError(f"ranges.{path}: expected the lower value first, got {low:g} and {high:g}")


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class Ranking:
    """Whether a metric ranks runs as errors do, by keys of ``metrics.json``."""

    by: MetricKey
    """The metric that ranks them."""
    errors: Annotated[tuple[MetricKey, ...], Field(min_length=1)]
    """What its order is held against."""
    estimate: Estimate | None = None
    """Runs by their ``filtered`` or by their ``smoothed`` poses; null: each by its final ones."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class StudyConfig:
    """A comparison repeated: every seed at every point."""

    seeds: Count = 50
    """Trials of a point: with the config's seed and those that follow it."""
    grid: dict[str, Annotated[tuple[Any, ...], Field(min_length=1)]] = Field(default_factory=dict)
    """Values by dotted path in the config; each is combined with each. Two points that are the same, as of 1
    and 1.0, are rejected, here and of an ablation."""
    named: dict[str, Annotated[dict[str, dict[str, Any]], Field(min_length=1)]] = Field(default_factory=dict)
    """Values that belong together, such as the noise of a sensor in the simulation and in the estimators: by
    parameter and by its level, each as values by dotted path, none for the config's own. Levels are combined
    with each other and with the grid, whose values are set last."""
    around: dict[str, Annotated[tuple[Any, ...], Field(min_length=1)]] = Field(default_factory=dict)
    """Values in place of a grid that are tried one at a time, all else as the config has it; it is a point,
    too."""
    latin_hypercube: LatinHypercube | None = None
    """Points in place of a grid."""
    defects: dict[str, Annotated[dict[str, Any], Field(min_length=1)]] = Field(default_factory=dict)
    """An ablation in place of a grid: things done wrong by name, each as values by dotted path; the
    config itself has none of them. They are corrected in this order, and each is there and is corrected
    alone."""
    metrics: tuple[MetricKey, ...] = ()
    """Metrics that ``trials.csv`` shows; empty: all. The files of the trials have them all."""
    ranking: Ranking | None = None
    """A metric whose order of the runs of a seed, those of all points and estimators, is held against their
    order by errors; null: none is."""

    def __post_init__(self) -> None:
        """Reject two sets of points, and parameters that would overwrite each other."""
        if sum(map(bool, (self.grid or self.named, self.around, self.latin_hypercube, self.defects))) > 1:
            raise ValueError(
                "one of grid, around, latin_hypercube and defects can be given, named with grid alone"
            )
        owner = dict.fromkeys(self.grid, "grid")
        for name, levels in self.named.items():
            if "." in name:
                raise ValueError(f"named: expected a name without a dot, which is no path, got {name}")
            for path in sorted({path for values in levels.values() for path in values}):
                if owner.setdefault(path, name) != name:
                    raise ValueError(
                        f"named.{name}: {path} is set by {owner[path]}, too; leave it to one of them"
                    )
