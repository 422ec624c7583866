"""What runs have estimated of the errors that all tracks share."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.core.run import Run
from vislam.models.shared_errors import SIZES, UNITS


@dataclass(frozen=True)
class EstimatedError:
    """A shared error at the last frame.

    Attributes
    ----------
    run, name : str
    value, sigma : (m,)
        Estimate from the data up to that frame, and its estimated standard deviation, which is NaN where it
        is not given. Of an error that is constant no later data says more.
    unit : str
        None for a share.
    """

    run: str
    name: str
    value: Array
    sigma: Array
    unit: str

    def record(self) -> dict[str, object]:
        """Plain data for JSON."""
        known = np.isfinite(self.sigma).all()
        return {
            "run": self.run,
            "name": self.name,
            "value": self.value.tolist(),
            "sigma": self.sigma.tolist() if known else None,
            "unit": self.unit,
        }


def estimated_errors(runs: Mapping[str, Run]) -> list[EstimatedError]:
    """Estimated shared errors of runs, in the order of the runs.

    The standard deviation is the last one that is given: who computes them now and then has given it for an
    earlier frame.
    """
    found = []
    for run in runs.values():
        for name in SIZES:
            history = run.states.get(name)
            if history is None or not len(history.value):
                continue
            given = np.flatnonzero(np.isfinite(history.sigma).all(axis=1))
            sigma = history.sigma[given[-1]] if len(given) else np.full(history.value.shape[1], np.nan)
            found.append(EstimatedError(run.name, name, history.value[-1], sigma, UNITS[name]))
    return found
