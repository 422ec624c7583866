"""The landmarks of short tracks in the normal equations: eliminated before all else, many at a time.

Landmarks are independent of each other given the poses. Each that is eliminated ties the poses that have
seen it to each other (Triggs et al., *Bundle adjustment: a modern synthesis*, 2000, section 6). With the
information ``H_ll = C C^T`` of a landmark, ``H_pl`` between it and the poses, and the right-hand side
``b_l``, what is left of the poses is ``H_pp - G G^T`` and ``b_p - G g`` with ``G = H_pl C^-T`` and
``g = C^-1 b_l``; then

    dl = C^-T (g - G^T dp),    Sigma_ll = C^-T (I + G^T Sigma_pp G) C^-1,    Sigma_lx = -C^-T G^T Sigma_px
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.estimators.smoother.observations import Linearised, Observations


@dataclass(frozen=True)
class LandmarkBlocks:
    """Information of all landmarks, and between them and the poses.

    Attributes
    ----------
    own : (m, 3, 3)
    right : (m, 3)
    across : (n, 6, 3)
        Between pose and landmark of each observation.
    """

    own: Array
    right: Array
    across: Array

    @classmethod
    def of(cls, seen: Observations, found: Linearised, landmarks: int) -> "LandmarkBlocks":
        """Blocks of linearised observations."""
        own, right = np.zeros((landmarks, 3, 3)), np.zeros((landmarks, 3))
        turned = found.by_point.transpose(0, 2, 1)
        np.add.at(own, seen.landmark, turned @ found.by_point)
        np.add.at(right, seen.landmark, -(turned @ found.residual[:, :, None])[:, :, 0])
        return cls(own, right, found.by_pose.transpose(0, 2, 1) @ found.by_point)


class Eliminated:
    """Landmarks that are eliminated first, in groups.

    Parameters
    ----------
    blocks : LandmarkBlocks
    seen : Observations
    column : (n, 6)
        Columns of the pose of each observation.
    group : (m,)
        Group of each landmark; -1 for one that is not eliminated here.
    groups : int

    Raises
    ------
    numpy.linalg.LinAlgError
        If a landmark is not determined.
    """

    def __init__(
        self, blocks: LandmarkBlocks, seen: Observations, column: IntArray, group: IntArray, groups: int
    ) -> None:
        order = np.argsort(group, kind="stable")
        self._landmarks = order[np.searchsorted(group[order], 0) :]
        self._ends = np.searchsorted(group[self._landmarks], np.arange(groups + 1))
        rank = np.full(len(group), -1)
        rank[self._landmarks] = np.arange(len(self._landmarks))
        of = rank[seen.landmark]
        rows = np.argsort(of, kind="stable")
        rows = rows[np.searchsorted(of[rows], 0) :]
        self._of, self._column = of[rows], column[rows]
        self._row_ends = np.searchsorted(self._of, self._ends)
        # Of the lower factors C.
        self._inverse = np.linalg.inv(np.linalg.cholesky(blocks.own[self._landmarks]))
        self._across = blocks.across[rows] @ self._inverse[self._of].transpose(0, 2, 1)
        self._right = (self._inverse @ blocks.right[self._landmarks, :, None])[:, :, 0]

    def landmarks(self, group: int) -> IntArray:
        """Landmarks ``(g,)`` of a group."""
        return self._landmarks[self._ends[group] : self._ends[group + 1]]

    def complement(self, group: int) -> tuple[IntArray, Array, Array]:
        """Columns ``(u,)`` that a group ties, its ``G (u, 3 g)`` and ``g (3 g,)``."""
        rows = slice(self._row_ends[group], self._row_ends[group + 1])
        first, end = self._ends[group], self._ends[group + 1]
        columns, at = np.unique(self._column[rows], return_inverse=True)
        tall = np.zeros((len(columns), 3 * (end - first)))
        right = 3 * (self._of[rows] - first)[:, None, None] + np.arange(3)
        tall[at.reshape(-1, 6, 1), right] = self._across[rows]
        return columns, tall, self._right[first:end].ravel()

    def solution(self, step: Array) -> Array:
        """Steps ``(g, 3)`` of the landmarks of all groups, by those ``(columns,)`` of all else."""
        moved = self._right.copy()
        np.add.at(moved, self._of, -(step[self._column][:, None, :] @ self._across)[:, 0])
        return (moved[:, None, :] @ self._inverse)[:, 0]

    @property
    def all_landmarks(self) -> IntArray:
        """Landmarks of all groups, in the order of :meth:`solution`."""
        return self._landmarks

    def covariances(self, group: int, tall: Array, sigma: Array) -> Array:
        """Covariances ``(g, 3, 3)`` of a group, by those ``(u, u)`` of the columns that it ties."""
        count = tall.shape[1] // 3
        spread = (sigma @ tall).reshape(len(tall), count, 3)
        inner = np.eye(3) + np.einsum("ugi,ugj->gij", tall.reshape(len(tall), count, 3), spread)
        inverse = self._inverse[self._ends[group] : self._ends[group + 1]]
        return inverse.transpose(0, 2, 1) @ inner @ inverse

    def cross_covariances(self, group: int, tall: Array, sigma: Array) -> Array:
        """Covariances ``(g, 3, d)`` of a group with some columns, by those ``(u, d)`` of the ones it ties."""
        inverse = self._inverse[self._ends[group] : self._ends[group + 1]]
        mixed = (tall.T @ sigma).reshape(len(inverse), 3, sigma.shape[1])
        return -inverse.transpose(0, 2, 1) @ mixed
