"""Reading of iSAM2's tree, and the order in which it eliminates what is newest."""

import re
from abc import ABC, abstractmethod
from collections.abc import Sequence
from itertools import chain
from typing import Any, NamedTuple

import gtsam
import numpy as np

from vislam.base.types import Array
from vislam.estimators.smoother.keys import A
from vislam.estimators.smoother.marginal import collected
from vislam.estimators.smoother.values import only

_ANCHOR_SIGMA = np.repeat([0.01, 0.1], 3)
"""How far an anchor may be from its pose [rad, m]."""


class IndeterminateError(RuntimeError):
    """GTSAM could not solve a step.

    Attributes
    ----------
    key : int or None
        The variable it names.
    """

    def __init__(self, text: str, key: int | None = None) -> None:
        super().__init__(text)
        self.key = key


class Reading(ABC):
    """Reading of an estimate from the tree that has it."""

    @abstractmethod
    def _with(self, *keys: int) -> gtsam.ISAM2:
        """Tree that has some variables."""

    def pose(self, key: int) -> Array:
        """Pose ``(4, 4)``."""
        return solved(self._with(key).calculateEstimatePose3, key).matrix()

    def vector(self, key: int) -> Array:
        """Vector variable."""
        return solved(self._with(key).calculateEstimateVector, key)

    def imu_bias(self, key: int) -> gtsam.imuBias.ConstantBias:
        """Biases of accelerometer and gyro."""
        return solved(self._with(key).calculateEstimateConstantBias, key)

    def points(self, keys: Sequence[int]) -> Array:
        """Points ``(n, 3)`` [m]."""
        read = self._with(*keys).calculateEstimatePoint3
        return np.array([read(key) for key in keys]).reshape(-1, 3)

    def covariance(self, key: int) -> Array:
        """Marginal covariance of a variable."""
        return solved(self._with(key).marginalCovariance, key)

    def calibration(self, key: int) -> gtsam.Cal3_S2:
        """Calibration of a camera."""
        return solved(self._with(key).calculateEstimateCal3_S2, key)

    def joint_covariance(self, keys: Sequence[int]) -> Array:
        """Joint covariance ``(d, d)`` of the errors of variables, in their order; all are different ones."""
        if len(keys) == 1:
            return self.covariance(keys[0])
        return joint_covariance(self._with(*keys), keys)


class Given(NamedTuple):
    """What a tree is given with an update."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    parameters: gtsam.ISAM2UpdateParams
    remove: list[int]


class Ordered(Reading):
    """iSAM2 that eliminates last what is newest.

    The landmarks in view are eliminated last and the newest frame's own variables before them: these are all
    that the next frame ties to, so that an update reaches no further back than what it tells of earlier
    frames. With the landmarks free, the ordering eliminates them among the poses that have seen them, and a
    step costs the more the longer the tracks are, and the longer the drive.

    GTSAM merges a clique into its parent where that has no variable beside the child's separator. The newest
    pose is eliminated before the frame's other variables, so that the anchor below is in the clique that
    comes first among them: else the poses that long tracks tie to each other, as one clique, would be merged
    with what the next frame ties to, and eliminated again with each.

    What is eliminated last carries all the drift: of its information, which is that of the last step, next to
    nothing is left once all else is eliminated, and GTSAM's Cholesky fails for a pivot that has lost more
    than seven digits. That is a matter of the order and not of the problem. So with Cholesky the very last is
    an anchor, a pose that is tied to the newest one and to nothing else, and is taken out again by the next
    update. It tells nothing of the rest. But the others then keep what they have within the tie, and the
    anchor, whose own information is that of the tie alone, takes the loss from there to the drift: seven
    digits in each of the two steps, a few hundred metres at any precision of the last step that occurs.
    """

    def __init__(self, parameters: gtsam.ISAM2Params) -> None:
        self._anchored = parameters.getFactorization() == "CHOLESKY"
        # Slot and key of the anchor.
        self._anchor: tuple[int, int] | None = None
        # What the last update eliminated last.
        self._last = gtsam.KeyGroupMap()
        # Whether to relinearise is said with each update.
        parameters.enableRelinearization = False
        self._qr: gtsam.ISAM2 | None = None

    def covariance(self, key: int) -> Array:
        """Marginal covariance of a variable, which Cholesky may fail to read from a tree that it has made."""
        try:
            return super().covariance(key)
        except IndeterminateError:
            return solved(self._by_qr().marginalCovariance, key)

    def joint_covariance(self, keys: Sequence[int]) -> Array:
        """Joint covariance ``(d, d)`` of the errors of variables, likewise."""
        try:
            return super().joint_covariance(keys)
        except IndeterminateError:
            return joint_covariance(self._by_qr(), keys)

    @abstractmethod
    def factors(self) -> dict[int, gtsam.NonlinearFactor]:
        """All factors but the anchor's, by slot."""

    @abstractmethod
    def linearization_point(self) -> gtsam.Values:
        """Where the factors were linearised last."""

    @abstractmethod
    def _next_slot(self) -> int:
        """Slot of the first factor that the next update brings."""

    def _ordered(
        self,
        newest: Sequence[int],
        in_view: Sequence[int],
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        remove: Sequence[int],
    ) -> Given:
        """Put an anchor in front of a frame's factors, and say what is eliminated last."""
        remove, order = list(remove), [newest[:1], newest[1:], in_view]
        if self._anchored:
            remove += [] if self._anchor is None else [self._anchor[0]]
            graph, values = self._with_anchor(newest[0], graph, values)
            order.append([A(gtsam.symbolIndex(newest[0]))])
        order = list(filter(len, order))
        # What has no group comes first, with group 0; where there is nothing of the kind, as many groups as
        # variables with another would be one too many.
        first = 0 if set(graph.keyVector()).issubset(chain(*order)) else 1
        self._last = gtsam.KeyGroupMap()
        for group, keys in enumerate(order, start=first):
            for key in keys:
                self._last.insert2(key, group)
        parameters = gtsam.ISAM2UpdateParams()
        parameters.constrainedKeys = self._last
        return Given(graph, values, parameters, remove)

    def _with_anchor(
        self, pose: int, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        key = A(gtsam.symbolIndex(pose))
        noise = gtsam.noiseModel.Diagonal.Sigmas(_ANCHOR_SIGMA)
        all_factors, all_values = gtsam.NonlinearFactorGraph(), gtsam.Values(values)
        all_factors.add(gtsam.BetweenFactorPose3(pose, key, gtsam.Pose3(), noise))
        all_factors.push_back(graph)
        all_values.insert(key, values.atPose3(pose))
        self._anchor = self._next_slot(), key
        return all_factors, all_values

    def _by_qr(self) -> gtsam.ISAM2:
        """Tree by QR of the same factors at the same linearisation point, made once after an update."""
        if self._qr is None:
            graph = collected(self.factors().values())
            self._qr = tree_by_qr(graph, only(self.linearization_point(), graph.keyVector()))
        return self._qr


def tree_by_qr(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> gtsam.ISAM2:
    """Bayes tree by QR of a graph, linearised at an estimate.

    Raises
    ------
    IndeterminateError
        If there is none.
    """
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization("QR")
    tree = gtsam.ISAM2(parameters)
    solved(tree.update, graph, values)
    return tree


def joint_covariance(solver: Any, keys: Sequence[int]) -> Array:
    """Joint covariance ``(d, d)`` of the errors of variables, in their order."""
    found = solved(solver.jointMarginalCovariance, list(keys))
    return np.block([[found.at(one, other) for other in keys] for one in keys])


def solved(call: Any, *arguments: Any) -> Any:
    """Call GTSAM; its exceptions arrive as plain ones whose text may name a variable."""
    try:
        return call(*arguments)
    except (RuntimeError, IndexError) as error:
        text = str(error)
        found = re.search(r"(\d{6,})\s*\(Symbol: ([^)]*)\)", text)
        if found:
            raise IndeterminateError(f"indeterminate at {found[2]}", int(found[1])) from None
        first = next((line.strip() for line in text.splitlines() if line.strip()), "no message")
        raise IndeterminateError(first) from None
