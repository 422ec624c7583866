"""Batch optimisation of a whole sequence, from the incremental estimate."""

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial

import gtsam
import numpy as np

from vislam.base.distributions import chi2_quantile
from vislam.base.types import Array, BoolArray
from vislam.core.frame import Frame
from vislam.estimators.smoother import schur_descent
from vislam.estimators.smoother.descent import Budget, Descent, descend
from vislam.estimators.smoother.factors import StereoFactors
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.motion import Motion
from vislam.estimators.smoother.objective import Objective
from vislam.estimators.smoother.observations import Observations
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.system import DriveSystem, Marginals
from vislam.estimators.smoother.tracks import Track, locate
from vislam.estimators.smoother.tree import joint_covariance, tree_by_qr
from vislam.estimators.smoother.values import only
from vislam.models import StereoRig

_CONVERGED = 1e-6
"""A round that lowers the cost by less than this share of it is the last one."""
_NOTHING = 1e-9
"""So is one that lowers it by less than this: squares of residuals in standard deviations."""
_GRADUATIONS = 50
_INNER_ITERATIONS = 3
_GRADUATION = 1.4
"""Factor by which each round of graduated non-convexity comes nearer to the truncated cost."""
_INLIER_PROBABILITY = 0.99
"""Share of good stereo factors whose residual stays below the truncation."""
_INLIER_WEIGHT = 0.5
"""A factor that ends with a smaller weight than this is an outlier."""
_NO_WEIGHT = 1e-6
"""Weight that an outlier keeps, so that its landmark keeps some tie."""


@dataclass(frozen=True)
class Optimum:
    """Result of an optimisation.

    Attributes
    ----------
    values : gtsam.Values
    cost : float
        Half the sum of the squared whitened residuals, under the robust kernel.
    rounds : int
        Triangulations and optimisations done.
    converged : bool
        Whether the last round converged.
    stopped : str
        Option whose budget ended it before; empty if none did.
    """

    values: gtsam.Values
    cost: float
    rounds: int
    converged: bool
    stopped: str


@dataclass
class Drive:
    """The batch problem of a whole sequence.

    Attributes
    ----------
    rig : StereoRig
    motion : Motion
    stereo : StereoFactors
    frames : sequence of Frame
    tracks : list of Track
        Its landmarks; outliers are taken out of them.
    others : gtsam.NonlinearFactorGraph, optional
        All factors but the stereo ones; by default the model of motion makes them.
    """

    rig: StereoRig
    motion: Motion
    stereo: StereoFactors
    frames: Sequence[Frame]
    tracks: list[Track]
    others: gtsam.NonlinearFactorGraph | None = None
    _whole: gtsam.NonlinearFactorGraph | None = field(default=None, init=False)
    _objective: Objective | None = field(default=None, init=False)

    def without_tracks(self) -> gtsam.NonlinearFactorGraph:
        """All factors but the stereo ones; a graph that may be added to."""
        if self.others is None:
            self.others = gtsam.NonlinearFactorGraph()
            for k, frame in enumerate(self.frames):
                for factor in self.motion.factors(frame, self.frames[k - 1] if k else None):
                    self.others.add(factor)
        return gtsam.NonlinearFactorGraph(self.others)

    def graph(self) -> gtsam.NonlinearFactorGraph:
        """All factors, the stereo ones last; made once, and not to be added to."""
        if self._whole is None:
            self._whole = self.weighted()
        return self._whole

    def weighted(self, weights: Array | None = None) -> gtsam.NonlinearFactorGraph:
        """All factors, rebuilt; ``weights`` are put on the squared residuals of the stereo ones."""
        graph = self.without_tracks()
        views = [(track.key, view) for track in self.tracks for view in track.views]
        scale = np.ones(len(views)) if weights is None else 1.0 / np.sqrt(np.maximum(weights, _NO_WEIGHT))
        for (key, view), much in zip(views, scale.tolist(), strict=True):
            sigma = view.sigma if much == 1.0 else much * view.sigma
            for factor in self.stereo.stereo(view.k, key, z=view.z, sigma=sigma):
                graph.add(factor)
        return graph

    def poses(self, values: gtsam.Values) -> Array:
        """Poses ``(T, 4, 4)``."""
        found = [values.atPose3(X(k)).matrix() for k in range(len(self.frames))]
        return np.array(found).reshape(-1, 4, 4)

    def triangulated(self, values: gtsam.Values, *, clear: float) -> gtsam.Values:
        """Values whose landmarks are re-triangulated from its poses, where their depth is clear."""
        if not self.tracks:
            return values
        found = locate(self.rig, self.stereo.errors, self.tracks, list(self.poses(values)), clear=clear)
        moved = gtsam.Values(values)
        for index in np.flatnonzero(found.ready).tolist():
            moved.update(self.tracks[index].key, found.points_world[index])
        return moved

    def optimise(self, values: gtsam.Values, options: SmootherOptions, budget: Budget) -> Optimum:
        """Maximum a posteriori estimate from an initial one, with the factors that the options name."""
        if options.factors == "stereo":
            return minimise(
                self._descent(values, options),
                values,
                cost=self.cost(values),
                restart=lambda values: self.triangulated(values, clear=options.initialisation_snr),
                rounds=options.final_iterations,
                budget=budget,
            )
        graph = self.without_tracks()
        for track in self.tracks:
            graph.add(self.stereo.smart(track.views))
        start = only(values, graph.keyVector())
        found = minimise(
            partial(by_gtsam, graph),
            start,
            cost=graph.error(start),
            restart=gtsam.Values,
            rounds=1,
            budget=budget,
        )
        everything = gtsam.Values(values)
        everything.update(found.values)
        located = self.triangulated(everything, clear=options.initialisation_snr)
        return replace(found, values=located, converged=not found.stopped)

    def cost(self, values: gtsam.Values) -> float:
        """Half the sum of the squared whitened residuals, under the robust kernel."""
        if self.stereo.repeated:
            return float(self.graph().error(values))
        objective = self.objective(values)
        return objective.cost(objective.estimate(values))

    def _descent(self, values: gtsam.Values, options: SmootherOptions) -> Callable[..., Descent]:
        """Levenberg-Marquardt as the options ask for it."""
        if options.optimiser == "schur":
            return partial(schur_descent.descend, self.objective(values))
        return partial(by_gtsam, self.graph())

    def graduate(self, values: gtsam.Values, budget: Budget) -> tuple[gtsam.Values, int]:
        """Take outliers out of the tracks; returns the values of what is left, and how many they were."""
        count = sum(len(track.views) for track in self.tracks)
        values, good = graduate(self.weighted, values, count=count, budget=budget)
        first = 0
        for track in self.tracks:
            kept = good[first : first + len(track.views)]
            first += len(track.views)
            track.views = [view for view, fine in zip(track.views, kept, strict=True) if fine]
        self.tracks = [track for track in self.tracks if track.views]
        self._whole = self._objective = None
        return only(values, self.graph().keyVector()), int(count - good.sum())

    def fit(self, values: gtsam.Values) -> tuple[float, int]:
        """Sum of the squared residuals, each by its noise, and how many more there are than unknowns."""
        if self.stereo.repeated:
            graph = self.graph()
            rows = sum(graph.at(index).dim() for index in range(graph.size()))
            rows -= self.stereo.repeated * sum(len(track.views) for track in self.tracks)
        else:
            rows = self.objective(values).rows
        return 2.0 * self.cost(values), rows - values.dim()

    def marginals(
        self, values: gtsam.Values, shared: Sequence[int] = (), *, landmarks: bool = True
    ) -> Marginals:
        """Marginal covariances: of a pose on its right, of a point in the world's axes.

        Parameters
        ----------
        values : gtsam.Values
        shared : sequence of int
            Variables of the first frame that cross-covariances are asked with.
        landmarks : bool
            Whether those of the landmarks are asked for.
        """
        # The normal equations have stereo observations of fixed calibration, and cross with the first pose.
        if not self.stereo.repeated and set(shared) <= {X(0)}:
            # Where Cholesky fails, a tree by QR does not.
            with suppress(np.linalg.LinAlgError):
                return self.system(values).marginals()
        return self._marginals_by_qr(values, shared, landmarks=landmarks)

    def joint_covariances(self, values: gtsam.Values, groups: Sequence[Sequence[int]]) -> list[Array]:
        """Joint covariances ``(d, d)`` of the errors of several variables each, in their order."""
        tree = tree_by_qr(self.graph(), values)
        return [joint_covariance(tree, keys) for keys in groups]

    def system(self, values: gtsam.Values) -> DriveSystem:
        """Normal equations at an estimate, factorised.

        Raises
        ------
        numpy.linalg.LinAlgError
            If they are not positive definite.
        """
        objective = self.objective(values)
        return objective.equations(objective.estimate(values)).factorised()

    def objective(self, values: gtsam.Values) -> Objective:
        """Cost with the observations as arrays, for the tracks as they are now; values have all variables."""
        if self._objective is None:
            self._objective = Objective(
                self.without_tracks(),
                Observations.of(self.tracks),
                [track.key for track in self.tracks],
                values,
                rig=self.rig,
                kernel=self.stereo.kernel,
                frames=len(self.frames),
            )
        return self._objective

    def _marginals_by_qr(self, values: gtsam.Values, shared: Sequence[int], *, landmarks: bool) -> Marginals:
        tree = tree_by_qr(self.graph(), values)
        points = [track.key for track in self.tracks] if landmarks else []
        poses = [X(k) for k in range(len(self.frames))]
        own = [tree.marginalCovariance(key) for key in [*poses, *points]]
        size, count = sum(values.zeroVectors().dim(key) for key in shared), len(poses)
        mixed = self._crossed(values, [*shared, *poses, *points], shared) if shared else []
        firsts, mixed = mixed[: len(shared)], mixed[len(shared) :]
        return Marginals(
            poses=np.array(own[:count]),
            points=np.array(own[count:]).reshape(len(points), 3, 3),
            poses_shared=np.array(mixed[:count]).reshape(count, 6, size),
            points_shared=np.array(mixed[count:]).reshape(len(points), 3, size),
            shared=np.concatenate(firsts) if firsts else np.zeros((0, 0)),
        )

    def _crossed(self, values: gtsam.Values, keys: Sequence[int], shared: Sequence[int]) -> list[Array]:
        """Covariances ``(d, m)`` of the errors of variables with those of others, ``shared``, in their order.

        With the information ``R^T R`` of all errors they are the columns ``R^-1 R^-T e`` of its inverse: one
        elimination, and a substitution forth and back for each component of the latter.
        """
        linear, nothing = self.graph().linearize(values), values.zeroVectors()
        try:
            net = linear.eliminateSequential(gtsam.Ordering.ColamdGaussianFactorGraph(linear))
        except RuntimeError:
            return self._crossed_by_qr(values, keys, shared)
        columns = []
        units = [(key, unit) for key in shared for unit in np.eye(nothing.dim(key))]
        for key, unit in units:
            right, only_one = gtsam.VectorValues(nothing), gtsam.VectorValues()
            only_one.insert(key, unit)
            right.update(only_one)
            solved = net.backSubstitute(net.backSubstituteTranspose(right))
            columns.append([solved.at(key) for key in keys])
        return [np.column_stack(of_key) for of_key in zip(*columns, strict=True)]

    def _crossed_by_qr(self, values: gtsam.Values, keys: Sequence[int], shared: Sequence[int]) -> list[Array]:
        """The same from joint marginals of a tree by QR, one after the other."""
        like = values.zeroVectors()
        size = sum(like.dim(key) for key in shared)
        start = dict(zip(shared, np.cumsum([0, *(like.dim(key) for key in shared)]).tolist(), strict=False))
        found = self.joint_covariances(values, [[*shared, *({key} - set(shared))] for key in keys])
        return [
            joint[start.get(key, size) : start.get(key, size) + like.dim(key), :size]
            for key, joint in zip(keys, found, strict=True)
        ]


def minimise(
    descent: Callable[..., Descent],
    values: gtsam.Values,
    *,
    cost: float,
    restart: Callable[[gtsam.Values], gtsam.Values],
    rounds: int,
    budget: Budget,
) -> Optimum:
    """Levenberg-Marquardt, restarted from ``restart`` of the best values, until convergence.

    Parameters
    ----------
    descent : callable
        Levenberg-Marquardt from some values, within ``budget=``.
    values : gtsam.Values
    cost : float
        Of these.
    restart : callable
        Values to start a round from, out of the best so far.
    rounds : int
        At most.
    budget : Budget
        Once it is spent, the best values so far are the result.
    """
    best, done, converged, stopped = values, 0, False, budget.spent
    while done < rounds and not converged and not stopped:
        done += 1
        found = descent(restart(best), budget=budget)
        converged = not found.cut and not found.cost < cost - max(_CONVERGED * cost, _NOTHING)
        if found.cost < cost:
            best, cost = found.values, found.cost
        stopped = budget.spent if found.cut or (done < rounds and not converged) else ""
    return Optimum(best, cost, done, converged, stopped)


def graduate(
    weighted: Callable[[Array], gtsam.NonlinearFactorGraph],
    values: gtsam.Values,
    *,
    count: int,
    budget: Budget,
) -> tuple[gtsam.Values, BoolArray]:
    """Graduated non-convexity with truncated least squares (Yang et al., IEEE RA-L 5, 2020, section IV-B).

    GTSAM's own optimiser copies all factors, which its motion factor does not allow.

    Parameters
    ----------
    weighted : callable
        Graph with the squared residuals of its last ``count`` factors times the given weights ``(count,)``.
    values : gtsam.Values
    count : int
        Number of factors that may be outliers.
    budget : Budget
        Once it is spent, the weights so far decide.

    Returns
    -------
    values : gtsam.Values
    good : (count,)
        Factors that are no outliers.
    """
    plain = weighted(np.ones(count))
    limit = float(chi2_quantile(_INLIER_PROBABILITY, 3))
    squared = _squared_residuals(plain, values, count)
    control = limit / max(2.0 * squared.max(initial=0.0) - limit, limit)
    weights = np.ones(count)
    for _ in range(_GRADUATIONS):
        root = np.sqrt(limit * control * (control + 1.0) / np.maximum(squared, 1e-12)) - control
        weights = np.where(squared <= limit * control / (control + 1.0), 1.0, np.clip(root, 0.0, 1.0))
        weights[squared >= limit * (control + 1.0) / control] = 0.0
        inner = descend(weighted(weights), values, solver="cholesky", budget=budget, most=_INNER_ITERATIONS)
        values = inner.values
        squared = _squared_residuals(plain, values, count)
        if budget.spent or np.all((weights == 0.0) | (weights == 1.0)):
            break
        control *= _GRADUATION
    return values, weights > _INLIER_WEIGHT


def by_gtsam(graph: gtsam.NonlinearFactorGraph, start: gtsam.Values, *, budget: Budget) -> Descent:
    """GTSAM's Levenberg-Marquardt with Cholesky, and from there with QR if steps were rejected."""
    found = descend(graph, start, solver="cholesky", budget=budget)
    if found.damped and not found.cut:
        found = descend(graph, found.values, solver="qr", budget=budget)
    return found


def _squared_residuals(graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, count: int) -> Array:
    first = graph.size() - count
    return 2.0 * np.array([graph.at(index).error(values) for index in range(first, graph.size())])
