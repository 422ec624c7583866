"""The incremental solvers of GTSAM behind one interface: the whole graph, or a window of fixed lag."""

import re
from array import array
from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Any, Protocol

import gtsam
import numpy as np

from vislam.base.types import Array
from vislam.estimators.smoother.keys import A, thresholds
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.segments import Segments

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

    def factors(self) -> gtsam.NonlinearFactorGraph:
        """All factors, by slot; empty where one was taken out."""
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


class _Read:
    """Reading of an estimate, which iSAM2 and the fixed-lag smoother answer to the same calls.

    Attributes
    ----------
    _solver : gtsam.ISAM2 or gtsam.IncrementalFixedLagSmoother
    """

    _solver: Any

    def linearization_point(self) -> gtsam.Values:
        """Where the factors were linearised last."""
        return self._solver.getLinearizationPoint()

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
        return joint_covariance(self._joint_solver(*keys), keys)

    def _with(self, *keys: int) -> Any:
        """What GTSAM has estimates of some variables of."""
        del keys
        return self._solver

    def _joint_solver(self, *keys: int) -> Any:
        """What GTSAM has joint covariances of."""
        return self._with(*keys)


class WholeGraph(_Read):
    """iSAM2 over the whole drive.

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

    What is old leaves the tree for the time of the steps (:mod:`vislam.estimators.smoother.segments`), unless
    all variables are to be up to date at each step.
    """

    def __init__(self, options: SmootherOptions, parameters: gtsam.ISAM2Params) -> None:
        self._options = options
        self._anchored = parameters.getFactorization() == "CHOLESKY"
        # Slot and key of the anchor.
        self._anchor: tuple[int, int] | None = None
        # What the last update eliminated last.
        self._last = gtsam.KeyGroupMap()
        # Whether to relinearise is said with each update.
        parameters.enableRelinearization = False
        self._segments = Segments(parameters, cut=options.wildfire_threshold != 0.0)
        self._qr: gtsam.ISAM2 | None = None
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
        parameters, frame = gtsam.ISAM2UpdateParams(), gtsam.symbolIndex(newest[0])
        remove, order = list(remove), [newest[:1], newest[1:], in_view]
        if self._anchored:
            remove += [] if self._anchor is None else [self._anchor[0]]
            graph, values = self._with_anchor(newest[0], graph, values)
            order.append([A(frame)])
        self._last = last = gtsam.KeyGroupMap()
        # What has no group comes first, with group 0; at the first frame there is nothing of the kind, and as
        # many groups as variables with another would be one too many.
        for group, keys in enumerate(filter(len, order), start=min(frame, 1)):
            for key in keys:
                last.insert2(key, group)
        parameters.constrainedKeys = last
        # By the frame: an engine that was rebuilt goes on where the one before would have.
        if self._options.relinearises(frame):
            parameters.force_relinearize = True
            parameters.noRelinKeys = self._resting
        slots = self._solve(graph, values, parameters, remove)
        # What is solved with each step stays, as the first pose where all others are reported by it.
        if self._segments.cut(self._at_rest, last, self._at_rest.intersection(newest)):
            self._set_resting()
        return slots[1:] if self._anchored else slots

    def linearization_point(self) -> gtsam.Values:
        """Where the factors were linearised last."""
        return self._segments.linearization_point()

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

    def _by_qr(self) -> gtsam.ISAM2:
        """Tree by QR of the same factors at the same linearisation point, made once after an update."""
        if self._qr is None:
            self._qr = tree_by_qr(self._segments.factors, self.linearization_point())
        return self._qr

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

    def factors(self) -> gtsam.NonlinearFactorGraph:
        """All factors but the anchor's, by slot."""
        found = gtsam.NonlinearFactorGraph(self._segments.factors)
        if self._anchor is not None:
            found.remove(self._anchor[0])
        return found

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

    def _with_anchor(
        self, pose: int, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values
    ) -> tuple[gtsam.NonlinearFactorGraph, gtsam.Values]:
        """Put an anchor beside the newest pose, in front of a frame's factors."""
        key = A(gtsam.symbolIndex(pose))
        noise = gtsam.noiseModel.Diagonal.Sigmas(_ANCHOR_SIGMA)
        all_factors, all_values = gtsam.NonlinearFactorGraph(), gtsam.Values(values)
        all_factors.add(gtsam.BetweenFactorPose3(pose, key, gtsam.Pose3(), noise))
        all_factors.push_back(graph)
        all_values.insert(key, values.atPose3(pose))
        self._anchor = self._segments.factors.size(), key
        return all_factors, all_values

    def _solve(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        parameters: gtsam.ISAM2UpdateParams,
        remove: Sequence[int] = (),
    ) -> list[int]:
        self._qr = None
        return _solved(self._segments.update, graph, values, parameters, remove)


class FixedLag(_Read):
    """GTSAM's incremental fixed-lag smoother: what was last seen before the lag is marginalised.

    A marginal is a quadratic at the linearisation point at which its factors were eliminated, and cannot be
    relinearised. Variables that it ties keep that point as long as this solver holds them, in all their other
    factors, too (``getFixedVariables``): the first-estimates rule, without which the two would have different
    unobservable directions (Huang, Mourikis and Roumeliotis, IEEE IROS 2011).
    """

    def __init__(self, options: SmootherOptions, parameters: gtsam.ISAM2Params) -> None:
        parameters.enableRelinearization = options.relinearize_every > 0
        parameters.relinearizeSkip = max(options.relinearize_every, 1)
        assert options.lag_s is not None
        self._solver = gtsam.IncrementalFixedLagSmoother(options.lag_s, parameters)
        # Factors that are given to it have consecutive slots; each update appends marginals behind them.
        self._marginals, self._end = array("q"), 0
        # Of an update that failed the factors are the last ones, and their slots are not known.
        self._unplaced = 0

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
        del newest, in_view, resting
        if remove:
            # The slot of a factor that has gone into a marginal is empty. To read the factors is to copy all
            # slots, of which there are the more the longer the sequence is.
            held = self._solver.getFactors()
            remove = [slot for slot in remove if held.exists(slot)]
        self._unplaced = graph.size()
        _solved(self._solver.update, graph, values, dict(stamps), list(remove))
        slots = list(self._solver.getISAM2Result().getNewFactorsIndices())
        self._unplaced = 0
        if slots:
            self._marginals.extend(range(self._end, slots[0]))
            self._end = slots[-1] + 1
        return slots

    def _joint_solver(self, *keys: int) -> Any:
        del keys
        return _solved(gtsam.Marginals, self._solver.getFactors(), self._solver.getLinearizationPoint())

    def factors(self) -> gtsam.NonlinearFactorGraph:
        """All factors, by slot; marginals with where they are linearised, which this solver alone holds."""
        found = gtsam.NonlinearFactorGraph(self._solver.getFactors())
        point = self._solver.getLinearizationPoint()
        newest = range(self._end, found.size() - self._unplaced)
        for slot in filter(found.exists, chain(self._marginals, newest)):
            marginal: Any = found.at(slot)
            found.replace(slot, gtsam.LinearContainerFactor(marginal.factor(), point))
        return found

    def estimate(self) -> gtsam.Values:
        """Estimate of all variables in the window."""
        return _solved(self._solver.calculateEstimate)


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
