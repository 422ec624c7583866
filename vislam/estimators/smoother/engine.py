"""The incremental solvers of GTSAM behind one interface: the whole graph, or a window of fixed lag."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import gtsam
import numpy as np

from vislam.base.types import Array
from vislam.estimators.smoother.keys import is_landmark, thresholds
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.segments import Segments
from vislam.estimators.smoother.tree import Ordered, solved
from vislam.estimators.smoother.window import Window

_POSE_SHARE = 0.05
"""A pose that moved by more than this share of the baseline is relinearised, unless the options say it."""
_WILDFIRE_SHARE = 1.7
"""A change of an old variable below this many baselines is left for the end, unless the options say it."""


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


class WholeGraph(Ordered):
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
        return self.newest()

    def newest(self) -> gtsam.Values:
        """Estimate of all variables that have not left the tree, but the anchor."""
        found = solved(self._segments.tree(()).calculateBestEstimate)
        if self._anchor is not None:
            found.erase(self._anchor[1])
        return found

    def without_landmarks(self) -> gtsam.NonlinearFactorGraph:
        """All factors that no landmark has."""
        found = gtsam.NonlinearFactorGraph()
        for factor in self.factors().values():
            if not (isinstance(factor, gtsam.GenericStereoFactor3D) or any(map(is_landmark, factor.keys()))):
                found.add(factor)
        return found

    @property
    def whole(self) -> bool:
        """Whether the tree has all variables."""
        return self._segments.whole

    def _with(self, *keys: int) -> gtsam.ISAM2:
        return solved(self._segments.tree, keys)

    def _join(self) -> None:
        """Have the whole tree."""
        if not self._segments.whole:
            solved(self._segments.join, self._last)
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
        return solved(self._segments.update, graph, values, parameters, remove)


class FixedLag(Ordered):
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
        slots = solved(self._window.update, *given)
        self._stamps.update(stamps)
        oldest = max(stamps.values()) - self._lag
        leaving = {key for key, stamp in self._stamps.items() if stamp < oldest}
        solved(self._window.leave, leaving)
        for key in leaving:
            del self._stamps[key]
        return slots[1:] if self._anchored else slots

    def linearization_point(self) -> gtsam.Values:
        """Where the factors were linearised last."""
        return self._window.held(self._window.tree.getLinearizationPoint())

    def factors(self) -> dict[int, gtsam.NonlinearFactor]:
        """All factors but the anchor's, by slot."""
        solved(self._window.eliminate)
        # Marginals first.
        found = dict(sorted(self._window.factors.items()))
        if self._anchor is not None:
            del found[self._anchor[0]]
        return found

    def estimate(self) -> gtsam.Values:
        """Estimate of all variables in the window."""
        found = self._window.held(solved(self._window.tree.calculateBestEstimate))
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
