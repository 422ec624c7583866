"""Whether runs had the same information; else their difference is not that of inference alone."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from itertools import combinations
from typing import Any

import numpy as np

from vislam.core.observation_set import CommonSet
from vislam.core.run import Run

LARGEST_SHARE = 0.01
"""Share of the common observations that a run may leave out, and its information still be called the same."""


@dataclass(frozen=True)
class SharedInformation:
    """What two runs had in common.

    Attributes
    ----------
    pair : tuple of str
    equal : bool
    differs : tuple of str
        In what they differ, a line each; empty if they are equal.
    """

    pair: tuple[str, str]
    equal: bool
    differs: tuple[str, ...]

    def record(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return asdict(self)


def shared_information(runs: Mapping[str, Run], common_set: CommonSet | None) -> list[SharedInformation]:
    """Compare the information of each pair of complete runs that use the camera.

    Noise of the motion, priors, cuts and repairs are the comparison's own and the same for all. What may
    differ is which observations a run was given and has taken, and how it says that it takes their noise and
    outliers.

    Parameters
    ----------
    runs : mapping of str to Run
        Runs of estimators of the comparison.
    common_set : CommonSet or None
        The observations that all were given; None if each chose for itself.
    """
    seeing = [run for run in runs.values() if not run.log.error and not run.blind]
    found = []
    for one, other in combinations(seeing, 2):
        differs = (*_observations(one, other, common_set), *_assumptions(one, other))
        found.append(SharedInformation((one.name, other.name), not differs, differs))
    return found


def unequal_line(found: list[SharedInformation]) -> str:
    """One line that names the runs whose information differed, and in what; empty if none's did.

    Runs that have the information of another are named with it, so that the line is no longer than there are
    kinds of information.
    """
    differs = {item.pair: item.differs for item in found}
    kinds: list[list[str]] = []
    for name in dict.fromkeys(name for pair in differs for name in pair):
        same = next((kind for kind in kinds if not differs[kind[0], name]), None)
        if same is None:
            kinds.append([name])
        else:
            same.append(name)
    said = [
        f"{_with_its_like(one)} and {_with_its_like(other)} ({'; '.join(differs[one[0], other[0]])})"
        for one, other in ((kinds[0], other) for other in kinds[1:])
    ]
    # Runs may be as good as equal to a third one, and not to each other.
    said += [
        f"{one} and {other} ({'; '.join(differs[one, other])})"
        for kind in kinds
        for one, other in combinations(kind, 2)
        if differs[one, other]
    ]
    return f"Information was not equal: {', '.join(said)}." if said else ""


def _with_its_like(kind: list[str]) -> str:
    first, *like = kind
    return f"{first} (so {', '.join(like)})" if like else first


def _observations(one: Run, other: Run, common_set: CommonSet | None) -> Iterator[str]:
    if common_set is None:
        differing = int(np.count_nonzero(one.used != other.used))
        if differing > LARGEST_SHARE * max(int(np.count_nonzero(one.used | other.used)), 1):
            yield f"no common list, {differing} observations were fused by one of them only"
        return
    left = common_set.not_fused({run.name: run for run in (one, other)})
    for name in (one.name, other.name):
        if name not in left:
            yield f"{name} was given all observations"
            continue
        share = left[name] / max(int(np.count_nonzero(common_set.kept)), 1)
        if share > LARGEST_SHARE:
            yield f"{name} left out {100.0 * share:.1f} % of the common observations"


def _assumptions(one: Run, other: Run) -> Iterator[str]:
    silent = [run.name for run in (one, other) if not run.information]
    if silent:
        yield f"{' and '.join(silent)} does not say what it assumes"
        return
    for key in sorted(one.information.keys() | other.information.keys()):
        said = [run.information.get(key, "not said") for run in (one, other)]
        if said[0] != said[1]:
            yield f"{key}: {said[0]} and {said[1]}"
