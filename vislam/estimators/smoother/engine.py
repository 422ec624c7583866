"""The incremental solvers of GTSAM behind one interface: the whole graph, or a window of fixed lag."""

import re
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any, NamedTuple, Protocol

import gtsam
import numpy as np

from vislam.base.types import Array
from vislam.estimators.smoother.keys import A, thresholds
from vislam.estimators.smoother.marginal import collected
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.segments import Segments
from vislam.estimators.smoother.values import only
from vislam.estimators.smoother.window import Window

_POSE_SHARE = 0.05
"""A pose that moved by more than this share of the baseline is relinearised, unless the options say it."""
_WILDFIRE_SHARE = 1.7
"""A change of an old variable below this many baselines is left for the end, unless the options say it."""
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


class Engine(Protocol):
    """Takes factors and values a frame at a time and holds the estimate."""

    def update(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        *,
        stamps: Mapping[int, float],
        newest: Sequence[int],
        in_view: Sequence[int],
        resting: Sequence[int],
        remove: Sequence[int],
    ) -> list[int]:
        """Take a frame; returns the slots of its factors.

        Parameters
        ----------
        graph : gtsam.NonlinearFactorGraph
        values : gtsam.Values
            First values of new variables.
        stamps : mapping of int to float
            Time of each variable that the frame has or sees [s].
        newest : sequence of int
            Variables of the frame, its pose first, and those that the next frame will be tied to.
        in_view : sequence of int
            Landmarks that it may see.
        resting : sequence of int
            Variables that are not relinearised from now on.
        remove : sequence of int
            Slots of factors to take out.

        Raises
        ------
        IndeterminateError
            After which the engine still tells its factors and its linearisation point, and nothing else.
        """
        ...

    def factors(self) -> dict[int, gtsam.NonlinearFactor]:
        """All factors by slot, those of the newest update last."""
        ...

    def linearization_point(self) -> gtsam.Values:
        """Where the factors were linearised last."""
        ...

    def estimate(self) -> gtsam.Values:
        """Estimate of all variables that are held."""
        ...

    def pose(self, key: int) -> Array:
        """Pose ``(4, 4)``."""
        ...

    def vector(self, key: int) -> Array:
        """Vector variable."""
        ...

    def imu_bias(self, key: int) -> gtsam.imuBias.ConstantBias:
        """Biases of accelerometer and gyro."""
        ...

    def points(self, keys: Sequence[int]) -> Array:
        """Points ``(n, 3)`` [m]."""
        ...

    def covariance(self, key: int) -> Array:
        """Marginal covariance of a variable."""
        ...

    def calibration(self, key: int) -> gtsam.Cal3_S2:
        """Calibration of a camera."""
        ...

    def joint_covariance(self, keys: Sequence[int]) -> Array:
        """Joint covariance ``(d, d)`` of the errors of variables, in their order; all are different ones."""
        ...


class _Read(ABC):
    """Reading of an estimate from the tree that has it."""

    @abstractmethod
    def _with(self, *keys: int) -> gtsam.ISAM2:
        """Tree that has some variables."""

    def pose(self, key: int) -> Array:
        """Pose ``(4, 4)``."""
        return _solved(self._with(key).calculateEstimatePose3, key).matrix()

    def vector(self, key: int) -> Array:
        """Vector variable."""
        return _solved(self._with(key).calculateEstimateVector, key)

    def imu_bias(self, key: int) -> gtsam.imuBias.ConstantBias:
        """Biases of accelerometer and gyro."""
        return _solved(self._with(key).calculateEstimateConstantBias, key)

    def points(self, keys: Sequence[int]) -> Array:
        """Points ``(n, 3)`` [m]."""
        read = self._with(*keys).calculateEstimatePoint3
        return np.array([read(key) for key in keys]).reshape(-1, 3)

    def covariance(self, key: int) -> Array:
        """Marginal covariance of a variable."""
        return _solved(self._with(key).marginalCovariance, key)

    def calibration(self, key: int) -> gtsam.Cal3_S2:
        """Calibration of a camera."""
        return _solved(self._with(key).calculateEstimateCal3_S2, key)

    def joint_covariance(self, keys: Sequence[int]) -> Array:
        """Joint covariance ``(d, d)`` of the errors of variables, in their order; all are different ones."""
        if len(keys) == 1:
            return self.covariance(keys[0])
        return joint_covariance(self._with(*keys), keys)


class _Given(NamedTuple):
    """What a tree is given with an update."""

    graph: gtsam.NonlinearFactorGraph
    values: gtsam.Values
    parameters: gtsam.ISAM2UpdateParams
    remove: list[int]


class _Ordered(_Read):
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
            return _solved(self._by_qr().marginalCovariance, key)

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
    ) -> _Given:
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
        return _Given(graph, values, parameters, remove)

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


class WholeGraph(_Ordered):
    """iSAM2 over the whole drive.

    What is old leaves the tree for the time of the steps (:mod:`vislam.estimators.smoother.segments`), unless
    all variables are to be up to date at each step.
    """

    def __init__(self, options: SmootherOptions, parameters: gtsam.ISAM2Params) -> None:
        super().__init__(parameters)
        self._options = options
        self._segments = Segments(parameters, cut=options.wildfire_threshold != 0.0)
        self._resting = gtsam.KeyList()
        self._at_rest: set[int] = set()

    def update(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        *,
        stamps: Mapping[int, float],
        newest: Sequence[int],
        in_view: Sequence[int],
        resting: Sequence[int],
        remove: Sequence[int],
    ) -> list[int]:
        """Take a frame."""
        del stamps
        self._rest(resting, back=self._at_rest.intersection(in_view))
        given, frame = self._ordered(newest, in_view, graph, values, remove), gtsam.symbolIndex(newest[0])
        # By the frame: an engine that was rebuilt goes on where the one before would have.
        if self._options.relinearises(frame):
            given.parameters.force_relinearize = True
            given.parameters.noRelinKeys = self._resting
        slots = self._solve(*given)
        # What is solved with each step stays, as the first pose where all others are reported by it.
        if self._segments.cut(self._at_rest, self._last, self._at_rest.intersection(newest)):
            self._set_resting()
        return slots[1:] if self._anchored else slots

    def linearization_point(self) -> gtsam.Values:
        """Where the factors were linearised last."""
        return self._segments.linearization_point()

    def relinearise(self) -> None:
        """Relinearise once what is not resting."""
        recent = gtsam.ISAM2UpdateParams()
        recent.force_relinearize = True
        recent.noRelinKeys = self._resting
        recent.constrainedKeys = self._last
        self._solve(gtsam.NonlinearFactorGraph(), gtsam.Values(), recent)

    def converge(self) -> None:
        """Relinearise everything once, unless nothing is to be, and solve it whole."""
        everything = gtsam.ISAM2UpdateParams()
        everything.force_relinearize = self._options.relinearize_every > 0
        everything.forceFullSolve = True
        everything.constrainedKeys = self._last
        self._join()
        self._solve(gtsam.NonlinearFactorGraph(), gtsam.Values(), everything)

    def factors(self) -> dict[int, gtsam.NonlinearFactor]:
        """All factors but the anchor's, by slot."""
        held, anchor = self._segments.factors, None if self._anchor is None else self._anchor[0]
        return {slot: held.at(slot) for slot in range(held.size()) if held.exists(slot) and slot != anchor}

    def estimate(self) -> gtsam.Values:
        """Estimate of all variables but the anchor."""
        self._join()
        found = _solved(self._segments.tree(()).calculateBestEstimate)
        if self._anchor is not None:
            found.erase(self._anchor[1])
        return found

    def _with(self, *keys: int) -> gtsam.ISAM2:
        return _solved(self._segments.tree, keys)

    def _join(self) -> None:
        """Have the whole tree."""
        if not self._segments.whole:
            _solved(self._segments.join, self._last)
            self._set_resting()

    def _rest(self, keys: Sequence[int], *, back: set[int]) -> None:
        """Relinearise some keys no more, and those again that have come ``back`` into view."""
        self._at_rest.update(keys)
        if back:
            self._at_rest -= back
            self._set_resting()
            return
        for key in keys:
            self._resting.push_back(key)

    def _set_resting(self) -> None:
        self._resting = gtsam.KeyList()
        for key in sorted(self._segments.held(self._at_rest)):
            self._resting.push_back(key)

    def _next_slot(self) -> int:
        return self._segments.factors.size()

    def _solve(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        parameters: gtsam.ISAM2UpdateParams,
        remove: Sequence[int] = (),
    ) -> list[int]:
        self._qr = None
        return _solved(self._segments.update, graph, values, parameters, remove)


class FixedLag(_Ordered):
    """iSAM2 over a lag: what was last seen before it is marginalised.

    What leaves (:mod:`vislam.estimators.smoother.window`) does so after the update with the frame by which it
    is too old, at the linearisation point of that update, as in GTSAM's ``IncrementalFixedLagSmoother``.
    """

    def __init__(self, options: SmootherOptions, parameters: gtsam.ISAM2Params) -> None:
        super().__init__(parameters)
        assert options.lag_s is not None
        self._options, self._lag = options, options.lag_s
        self._window = Window(parameters)
        # When each variable was last seen.
        self._stamps: dict[int, float] = {}

    def update(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        *,
        stamps: Mapping[int, float],
        newest: Sequence[int],
        in_view: Sequence[int],
        resting: Sequence[int],
        remove: Sequence[int],
    ) -> list[int]:
        """Take a frame."""
        del resting
        given = self._ordered(newest, in_view, graph, values, remove)
        if self._options.relinearises(gtsam.symbolIndex(newest[0])):
            given.parameters.force_relinearize = True
            given.parameters.noRelinKeys = gtsam.KeyList()
            for key in sorted(self._window.fixed):
                given.parameters.noRelinKeys.push_back(key)
        self._qr = None
        slots = _solved(self._window.update, *given)
        self._stamps.update(stamps)
        oldest = max(stamps.values()) - self._lag
        leaving = {key for key, stamp in self._stamps.items() if stamp < oldest}
        _solved(self._window.leave, leaving)
        for key in leaving:
            del self._stamps[key]
        return slots[1:] if self._anchored else slots

    def linearization_point(self) -> gtsam.Values:
        """Where the factors were linearised last."""
        return self._window.held(self._window.tree.getLinearizationPoint())

    def factors(self) -> dict[int, gtsam.NonlinearFactor]:
        """All factors but the anchor's, by slot."""
        found = _solved(self._window.factors)
        if self._anchor is not None:
            del found[self._anchor[0]]
        return found

    def estimate(self) -> gtsam.Values:
        """Estimate of all variables in the window."""
        found = self._window.held(_solved(self._window.tree.calculateBestEstimate))
        if self._anchor is not None:
            found.erase(self._anchor[1])
        return found

    def _with(self, *keys: int) -> gtsam.ISAM2:
        del keys
        return self._window.tree

    def _next_slot(self) -> int:
        return self._window.size


def make(
    options: SmootherOptions, *, factorization: str, baseline: float, own: Mapping[str, Array]
) -> Engine:
    """Engine that the options ask for.

    Parameters
    ----------
    options : SmootherOptions
    factorization : str
        qr or cholesky.
    baseline : float
        That of the rig [m].
    own : mapping of str to Array
        Relinearisation thresholds of the variables of the model of motion, by the letter of their keys.
    """
    kind = WholeGraph if options.lag_s is None else FixedLag
    return kind(options, _parameters(options, factorization, baseline=baseline, own=own))


def _parameters(
    options: SmootherOptions, factorization: str, *, baseline: float, own: Mapping[str, Array]
) -> gtsam.ISAM2Params:
    parameters = gtsam.ISAM2Params()
    parameters.setFactorization(factorization.upper())
    least = options.wildfire_threshold
    least = _WILDFIRE_SHARE * baseline if least is None else least
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(least))
    moved = _pose_threshold(options, baseline)
    pose = np.repeat([options.pose_threshold_rad, moved], 3)
    table = thresholds(pose=pose, depth_share=options.landmark_threshold, own=own)
    parameters.setRelinearizeThreshold(table)
    return parameters


def _pose_threshold(options: SmootherOptions, baseline: float) -> float:
    """Largest move of a pose that is not relinearised [m]."""
    return _POSE_SHARE * baseline if options.pose_threshold_m is None else options.pose_threshold_m


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
    _solved(tree.update, graph, values)
    return tree


def joint_covariance(solver: Any, keys: Sequence[int]) -> Array:
    """Joint covariance ``(d, d)`` of the errors of variables, in their order."""
    found = _solved(solver.jointMarginalCovariance, list(keys))
    return np.block([[found.at(one, other) for other in keys] for one in keys])


def _solved(call: Any, *arguments: Any) -> Any:
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
