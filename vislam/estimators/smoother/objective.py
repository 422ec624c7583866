"""The cost of a drive with its stereo observations as arrays: its value, its normal equations, its steps.

All other factors and their variables are GTSAM's. The cost is GTSAM's of the whole graph, half the sum of the
squared whitened residuals, under the kernel where there is one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import gtsam
import numpy as np

from vislam.base.types import Array
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.layout import Variables
from vislam.estimators.smoother.observations import Observations
from vislam.estimators.smoother.system import NormalEquations, Structure
from vislam.estimators.smoother.values import only
from vislam.models import Kernel, StereoRig


@dataclass(frozen=True)
class Estimate:
    """Values of all variables.

    Attributes
    ----------
    states : gtsam.Values
        Of all but the landmarks.
    poses : (T, 4, 4)
        Those among them.
    points : (m, 3)
        Landmarks, in the world's axes [m].
    """

    states: gtsam.Values
    poses: Array
    points: Array


class Objective:
    """Cost of a drive.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        All factors but the stereo ones.
    seen : Observations
    keys : sequence of int
        Of the landmarks, in the order of ``seen``.
    values : gtsam.Values
        Any that have all variables.
    rig : StereoRig
    kernel : Kernel or None
        Of the observations.
    frames : int
    """

    def __init__(
        self,
        graph: gtsam.NonlinearFactorGraph,
        seen: Observations,
        keys: Sequence[int],
        values: gtsam.Values,
        *,
        rig: StereoRig,
        kernel: Kernel | None,
        frames: int,
    ) -> None:
        self._graph, self._seen, self._keys, self._rig, self._kernel = graph, seen, keys, rig, kernel
        self._variables = Variables.of(graph, values)
        self._structure = Structure(self._variables, seen, frames, len(keys))

    @property
    def rows(self) -> int:
        """Number of residuals."""
        rows = sum(self._graph.at(index).dim() for index in range(self._graph.size()))
        return rows + self._seen.z.size

    @property
    def width(self) -> int:
        """Columns of the widest front of the normal equations."""
        return self._structure.layout.width

    def estimate(self, values: gtsam.Values) -> Estimate:
        """Estimate from the values of all variables."""
        points = np.array([values.atPoint3(key) for key in self._keys]).reshape(-1, 3)
        return self._with(only(values, self._variables.keys), points)

    def values(self, estimate: Estimate) -> gtsam.Values:
        """Values of all variables."""
        found = gtsam.Values(estimate.states)
        for key, point in zip(self._keys, estimate.points, strict=True):
            found.insert(key, point)
        return found

    def cost(self, estimate: Estimate) -> float:
        """Half the sum of the squared whitened residuals, under the kernel."""
        squared = self._seen.squared(self._rig, estimate.poses, estimate.points)
        loss = squared if self._kernel is None else self._kernel.loss(squared)
        return float(self._graph.error(estimate.states)) + 0.5 * float(np.sum(loss))

    def equations(self, estimate: Estimate) -> NormalEquations:
        """Normal equations at an estimate."""
        found = self._seen.linearise(self._rig, estimate.poses, estimate.points, kernel=self._kernel)
        return NormalEquations(self._structure, self._graph.linearize(estimate.states), found)

    def moved(self, estimate: Estimate, states: Array, points: Array) -> Estimate:
        """Estimate after a step ``(n,)`` of the columns of the variables and ``(m, 3)`` of the landmarks."""
        step, start = gtsam.VectorValues(), self._variables.start.tolist()
        for key, first, end in zip(self._variables.keys, start, start[1:], strict=False):
            step.insert(key, states[first:end])
        return self._with(estimate.states.retract(step), estimate.points + points)

    def _with(self, states: gtsam.Values, points: Array) -> Estimate:
        found = [states.atPose3(X(k)).matrix() for k in range(self._structure.frames)]
        return Estimate(states, np.array(found).reshape(-1, 4, 4), points)
