"""The order in which the variables of a drive are eliminated, and where their columns come to be.

It depends on what is observed and tied, not on the estimate, and is made once for all iterations.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import chain

import gtsam
import numpy as np

from vislam.base.types import BoolArray, IntArray
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.observations import Observations

_FRAMES = 4
"""Frames of a front: fewer make more calls, more make wider fronts."""
_OWN = 15
"""Columns that a frame brings beside its landmarks, about."""
_NEIGHBOURS = 2
"""Frames that a factor of what walks reaches back; what is tied to later ones is constant."""


@dataclass(frozen=True)
class Variables:
    """The variables of all factors but the stereo ones.

    Attributes
    ----------
    keys : list of int
        In the order of their columns.
    start : (v + 1,)
        First column of each, and the number of columns.
    factor, of_factor : (e,)
        Each factor with each of its variables, by their place in ``keys``, factor after factor.
    """

    keys: list[int]
    start: IntArray
    factor: IntArray
    of_factor: IntArray

    @classmethod
    def of(cls, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values) -> "Variables":
        """Variables of a graph, with the dimensions that its values have."""
        tied = [graph.at(index).keys() for index in range(graph.size())]
        keys = sorted(set(chain.from_iterable(tied)))
        zero = values.zeroVectors()
        start = np.concatenate([[0], np.cumsum([zero.dim(key) for key in keys])]).astype(np.int64)
        place = {key: index for index, key in enumerate(keys)}
        of_factor = np.array([place[key] for key in chain.from_iterable(tied)], dtype=np.int64)
        return cls(keys, start, np.repeat(np.arange(len(tied)), list(map(len, tied))), of_factor)

    @cached_property
    def frame(self) -> IntArray:
        """Frame ``(v,)`` of each variable; 0 of what is constant."""
        return np.array([gtsam.symbolIndex(key) for key in self.keys], dtype=np.int64)

    @cached_property
    def lasting(self) -> BoolArray:
        """Which of them ``(v,)`` are eliminated last: the first pose, and what is constant."""
        latest = np.zeros(self.factor[-1] + 1, np.int64)
        np.maximum.at(latest, self.factor, self.frame[self.of_factor])
        reaches = np.zeros(len(self.keys), np.int64)
        np.maximum.at(reaches, self.of_factor, latest[self.factor])
        found = (self.frame == 0) & (reaches > _NEIGHBOURS)
        found[self.keys.index(X(0))] = True
        return found

    def poses(self, frames: int) -> IntArray:
        """Columns ``(frames, 6)`` of the poses."""
        at = dict(zip(self.keys, self.start.tolist(), strict=False))
        return np.array([at[X(k)] for k in range(frames)])[:, None] + np.arange(6)

    def columns(self, of_variables: IntArray) -> IntArray:
        """What is given for each variable ``(v,)``, for each column ``(n,)``."""
        return np.repeat(of_variables, np.diff(self.start))

    def earliest(self, of_variables: IntArray) -> IntArray:
        """Least ``(v,)`` of a number of each variable over all that share a factor with it."""
        least = np.full(self.factor[-1] + 1, np.iinfo(np.int64).max)
        np.minimum.at(least, self.factor, of_variables[self.of_factor])
        found = of_variables.copy()
        np.minimum.at(found, self.of_factor, least[self.factor])
        return found


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


class Layout:
    """Columns of all that is not eliminated first, in the order of their elimination, front by front.

    The newest frames come first, and the first pose, which its prior holds, last: a drive is fixed at that
    end alone. In the order of time, covariances would come back from those of the whole drift, as small
    differences of large numbers, and grow in error with each front.

    Parameters
    ----------
    variables : Variables
    seen : Observations
    frames, landmarks : int

    Attributes
    ----------
    state : (n,)
        Where the columns of the variables have come to be.
    pose : (T, 6)
        Those of the poses.
    point : (m, 3)
        Those of the landmarks of long tracks; 0 for the others.
    long : (m,)
        Whether a landmark has columns.
    group : (m,)
        Front before which a landmark without is eliminated; -1 for the others.
    fronts : int
    ends : (fronts + 1,)
        Front i eliminates the columns from ``ends[i]`` to ``ends[i + 1]``.
    begin : (c,)
        First front of each column: the first that eliminates a neighbour of it.
    front_of_pose, front_of_point : (T,), (m,)
        Where each is eliminated; -1 for a landmark without columns.
    """

    def __init__(self, variables: Variables, seen: Observations, *, frames: int, landmarks: int) -> None:
        newest = frames - 1
        last, first = (newest - frame for frame in seen.span(landmarks))
        self.long = last - first >= longest_eliminated(first, last, frames)
        self.group = np.where(self.long, -1, first // _FRAMES)
        self.fronts = -(-frames // _FRAMES) + 1
        of_variables = np.where(variables.lasting, self.fronts - 1, (newest - variables.frame) // _FRAMES)
        self.front_of_point = np.where(self.long, last // _FRAMES, -1)
        front = np.concatenate(
            [variables.columns(of_variables), np.repeat(self.front_of_point[self.long], 3)]
        )
        order = np.argsort(front, kind="stable")
        column = np.argsort(order)
        states = int(variables.start[-1])
        self.state, self.pose = column[:states], column[variables.poses(frames)]
        self.point = np.zeros((landmarks, 3), np.int64)
        self.point[self.long] = column[states:].reshape(-1, 3)
        self.ends = np.searchsorted(front[order], np.arange(self.fronts + 1))
        self.front_of_pose = front[order][self.pose[:, 0]]
        self.begin = front[order]
        self.begin[self.state] = variables.columns(variables.earliest(of_variables))
        self._tie(seen)
        # Covariances with the first pose are asked for in all fronts.
        self.begin[self.pose[0]] = 0

    @property
    def width(self) -> int:
        """Columns of the widest front."""
        front = np.repeat(np.arange(self.fronts), np.diff(self.ends))
        begun = np.cumsum(np.bincount(self.begin, minlength=self.fronts))
        ended = np.concatenate([[0], np.cumsum(np.bincount(front, minlength=self.fronts))[:-1]])
        return int((begun - ended).max())

    def _tie(self, seen: Observations) -> None:
        """Let poses and landmarks begin with the first front that eliminates a neighbour by observation."""
        pose, point = self.front_of_pose[seen.frame], self.front_of_point[seen.landmark]
        long = self.long[seen.landmark]
        first = np.where(long, np.minimum(pose, point), self.group[seen.landmark])
        np.minimum.at(self.begin, self.pose[seen.frame], first[:, None])
        np.minimum.at(self.begin, self.point[seen.landmark[long]], first[long, None])
