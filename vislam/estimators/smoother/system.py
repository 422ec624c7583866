"""The normal equations of a whole drive, factorised: one Gauss-Newton step, and all marginals in one pass.

Landmarks of short tracks are eliminated first (:mod:`vislam.estimators.smoother.schur`), all else front by
front in order of time (:mod:`vislam.estimators.smoother.frontal`). A landmark that is seen for long would tie
as many poses, of six columns each; it stays in the front for as long as it is seen, with three.
"""

from dataclasses import dataclass

import gtsam
import numpy as np
from scipy import sparse

from vislam.base.types import Array, IntArray
from vislam.estimators.smoother.frontal import Factorisation
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.observations import Linearised, Observations
from vislam.estimators.smoother.schur import Eliminated, LandmarkBlocks

_FRAMES = 4
"""Frames of a front: fewer make more calls, more make wider fronts."""
_OWN = 15
"""Columns that a frame brings beside its landmarks, about."""


@dataclass(frozen=True)
class Others:
    """All factors but the stereo ones, linearised.

    Attributes
    ----------
    keys : list of int
        Variables, in the order of their columns.
    start : (v + 1,)
        First column of each, and the number of columns.
    jacobian : sparse array (m, n)
        Whitened.
    right : (m,)
        Whitened residuals, with the sign turned.
    """

    keys: list[int]
    start: IntArray
    jacobian: sparse.csr_array
    right: Array

    @classmethod
    def of(cls, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> "Others":
        """Linearise a graph."""
        linear, zero = graph.linearize(values), values.zeroVectors()
        keys = sorted(graph.keyVector())
        start = np.concatenate([[0], np.cumsum([len(zero.at(key)) for key in keys])])
        row, column, entry = linear.sparseJacobian_()
        where = row.astype(np.int64) - 1, column.astype(np.int64) - 1
        whole = sparse.csr_array((entry, where), shape=(int(where[0].max()) + 1, int(start[-1]) + 1))
        return cls(keys, start, whole[:, :-1], whole[:, [-1]].toarray()[:, 0])

    @property
    def frame(self) -> IntArray:
        """Frame ``(n,)`` of each column; 0 of what is constant."""
        return np.repeat([gtsam.symbolIndex(key) for key in self.keys], np.diff(self.start))

    def poses(self, frames: int) -> IntArray:
        """Columns ``(frames, 6)`` of the poses."""
        at = dict(zip(self.keys, self.start.tolist(), strict=False))
        return np.array([at[X(k)] for k in range(frames)])[:, None] + np.arange(6)

    @property
    def lasting(self) -> IntArray:
        """Columns of the first pose and of what is constant, which are eliminated last."""
        constant = [gtsam.symbolChr(key) in map(ord, "cd") or key == X(0) for key in self.keys]
        return np.flatnonzero(np.repeat(constant, np.diff(self.start)))


@dataclass(frozen=True)
class Marginals:
    """Covariances of poses ``(T, 6, 6)`` and landmarks ``(n, 3, 3)``.

    Attributes
    ----------
    poses, points
    poses_shared, points_shared : (T, 6, m), (n, 3, m)
        Those with some variables of the first frame.
    shared : (m, m)
        Of the latter.
    """

    poses: Array
    points: Array
    poses_shared: Array
    points_shared: Array
    shared: Array


def longest_eliminated(first: IntArray, last: IntArray, frames: int) -> int:
    """Frames from the first to the last view of the longest tracks that are best eliminated first.

    Of the limits that are tried it is the one that makes the sum of the squared sizes of all fronts least.

    Parameters
    ----------
    first, last : (m,)
        Frames in which each landmark is seen.
    frames : int
    """
    span, at = last - first + 1, np.arange(frames)
    costs = {}
    for limit in np.unique(np.round(2.0 ** np.arange(0.0, np.log2(frames) + 1.0, 0.5)).astype(int)).tolist():
        short, ahead = span <= limit, at.copy()
        np.maximum.at(ahead, first[short], last[short])
        begun = np.bincount(first[~short], minlength=frames)
        ended = np.bincount(last[~short] + 1, minlength=frames + 1)[:frames]
        size = 6 * (np.maximum.accumulate(ahead) - at) + 3 * np.cumsum(begun - ended) + _OWN * _FRAMES
        costs[limit] = float(np.sum(size.astype(float) ** 2))
    return min(costs, key=costs.__getitem__)


class DriveSystem:
    """Normal equations of a drive, factorised.

    Parameters
    ----------
    others : Others
    seen : Observations
    found : Linearised
    frames, landmarks : int

    Raises
    ------
    numpy.linalg.LinAlgError
        If they are not positive definite.
    """

    def __init__(
        self, others: Others, seen: Observations, found: Linearised, *, frames: int, landmarks: int
    ) -> None:
        first, last = seen.span(landmarks)
        short = last - first < longest_eliminated(first, last, frames)
        long, states = np.flatnonzero(~short), int(others.start[-1])
        fronts = -(-frames // _FRAMES) + 1
        front = np.concatenate([others.frame // _FRAMES, np.repeat(last[long] // _FRAMES, 3)])
        front[others.lasting] = fronts - 1
        order = np.argsort(front, kind="stable")
        # Where the columns of all states, of the poses and of the landmarks of long tracks have come to be.
        column = np.argsort(order)
        self._states, self._pose = column[:states], column[others.poses(frames)]
        self._point = np.zeros((landmarks, 3), np.int64)
        self._point[long] = column[states:].reshape(-1, 3)
        self._long, self._front = long, front[order]
        group = np.where(short, first // _FRAMES, -1)
        blocks = LandmarkBlocks.of(seen, found, landmarks)
        self._short = Eliminated(blocks, seen, self._pose[seen.frame], group, fronts)
        jacobian = self._jacobian(others, seen, found)
        information = (jacobian.T @ jacobian).tocsc()
        self._factorisation = Factorisation(
            information,
            jacobian.T @ np.concatenate([others.right, -found.residual.ravel()]),
            begin=self._begin(information, seen, group),
            ends=np.searchsorted(self._front, np.arange(fronts + 1)),
            complement=self._short.complement,
        )

    def step(self) -> tuple[Array, Array]:
        """Step ``(n,)`` of all columns of :class:`Others`, and ``(m, 3)`` of the landmarks."""
        step = self._factorisation.solve()
        points = step[self._point]
        points[self._short.all_landmarks] = self._short.solution(step)
        return step[self._states], points

    def marginals(self) -> Marginals:
        """Covariances of all poses and landmarks, and those with the first pose."""
        frames, landmarks = len(self._pose), len(self._point)
        poses, points = np.empty((frames, 6, 6)), np.empty((landmarks, 3, 3))
        poses_first, points_first = np.empty((frames, 6, 6)), np.empty((landmarks, 3, 6))
        front_of_pose = self._front[self._pose[:, 0]]
        front_of_long = self._front[self._point[self._long, 0]]
        for number, place, sigma in self._factorisation.covariances():
            with_first = sigma[:, place[self._pose[0]]]
            which = np.flatnonzero(front_of_pose == number)
            at = place[self._pose[which]]
            poses[which], poses_first[which] = sigma[at[:, :, None], at[:, None]], with_first[at]
            which = self._long[front_of_long == number]
            at = place[self._point[which]]
            points[which], points_first[which] = sigma[at[:, :, None], at[:, None]], with_first[at]
            columns, tall, _ = self._short.complement(number)
            at, which = place[columns], self._short.landmarks(number)
            points[which] = self._short.covariances(number, tall, sigma[np.ix_(at, at)])
            points_first[which] = self._short.cross_covariances(number, tall, with_first[at])
        return Marginals(poses, points, poses_first, points_first, poses[0])

    def _jacobian(self, others: Others, seen: Observations, found: Linearised) -> sparse.csr_array:
        """Jacobian of all factors by all columns that are not eliminated first."""
        rest, count = others.jacobian.tocoo(), len(seen.frame)
        rows = others.jacobian.shape[0] + np.arange(3 * count).reshape(-1, 3, 1)
        is_long = np.isin(seen.landmark, self._long)
        blocks = [
            (rows, self._pose[seen.frame][:, None], found.by_pose),
            (rows[is_long], self._point[seen.landmark[is_long], None], found.by_point[is_long]),
        ]
        row, column = [rest.row], [self._states[rest.col]]
        for block_rows, columns, entries in blocks:
            row.append(np.broadcast_to(block_rows, entries.shape).ravel())
            column.append(np.broadcast_to(columns, entries.shape).ravel())
        entry = np.concatenate([rest.data, *(entries.ravel() for _, _, entries in blocks)])
        where = np.concatenate(row), np.concatenate(column)
        return sparse.csr_array(
            (entry, where), shape=(others.jacobian.shape[0] + 3 * count, len(self._front))
        )

    def _begin(self, information: sparse.csc_array, seen: Observations, group: IntArray) -> IntArray:
        """First front of each column: the first that eliminates a neighbour of it."""
        begin = self._front.copy()
        neighbour = np.repeat(self._front, np.diff(information.indptr))
        np.minimum.at(begin, information.indices, neighbour)
        of = group[seen.landmark]
        np.minimum.at(begin, self._pose[seen.frame[of >= 0]], of[of >= 0, None])
        return begin
