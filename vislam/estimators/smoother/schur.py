"""The landmarks of short tracks in the normal equations: eliminated before all else, many at a time.

Landmarks are independent of each other given the poses. Each that is eliminated ties the poses that have
seen it to each other (Triggs et al., *Bundle adjustment: a modern synthesis*, 2000, section 6). With the
information ``H_ll = C C^T`` of a landmark, ``H_pl`` between it and the poses, and the right-hand side
``b_l``, what is left of the poses is ``H_pp - G G^T`` and ``b_p - G g`` with ``G = H_pl C^-T`` and
``g = C^-1 b_l``; then

    dl = C^-T (g - G^T dp),    Sigma_ll = C^-T (I + G^T Sigma_pp G) C^-1,    Sigma_lx = -C^-T G^T Sigma_px
"""

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.estimators.smoother.observations import Linearised, Observations


class Groups:
    """Which landmarks are eliminated first, in groups, with the observations of each.

    Parameters
    ----------
    seen : Observations
    column : (n, 6)
        Columns of the pose of each observation.
    group : (m,)
        Group of each landmark; -1 for one that is not eliminated here.
    groups : int

    Attributes
    ----------
    landmarks : (g,)
        Those of all groups, one group after the other.
    rows : (r,)
        Their observations, in the same order.
    of : (r,)
        Place in ``landmarks`` of each.
    column : (r, 6)
    """

    def __init__(self, seen: Observations, column: IntArray, group: IntArray, groups: int) -> None:
        order = np.argsort(group, kind="stable")
        self.landmarks = order[np.searchsorted(group[order], 0) :]
        self._ends = np.searchsorted(group[self.landmarks], np.arange(groups + 1))
        rank = np.full(len(group), -1)
        rank[self.landmarks] = np.arange(len(self.landmarks))
        of = rank[seen.landmark]
        rows = np.argsort(of, kind="stable")
        self.rows = rows[np.searchsorted(of[rows], 0) :]
        self.of, self.column = of[self.rows], column[self.rows]
        self._row_ends = np.searchsorted(self.of, self._ends)

    def of_group(self, group: int) -> slice:
        """Places in ``landmarks`` of a group."""
        return slice(self._ends[group], self._ends[group + 1])

    def rows_of(self, group: int) -> slice:
        """Places in ``rows`` of a group."""
        return slice(self._row_ends[group], self._row_ends[group + 1])


class Eliminated:
    """Landmarks that are eliminated first.

    Parameters
    ----------
    groups : Groups
    found : Linearised
        All observations.
    own : (m, 3, 3)
        Information of all landmarks by their observations.
    right : (m, 3)
        Their right-hand side.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a landmark is not determined.
    """

    def __init__(self, groups: Groups, found: Linearised, own: Array, right: Array) -> None:
        self._groups = groups
        # Of the lower factors C.
        self._inverse = np.linalg.inv(np.linalg.cholesky(own[groups.landmarks]))
        back = self._inverse.transpose(0, 2, 1)[groups.of]
        by_pose, by_point = found.by_pose[groups.rows], found.by_point[groups.rows]
        self._across = by_pose.transpose(0, 2, 1) @ (by_point @ back)
        self._right = (self._inverse @ right[groups.landmarks, :, None])[:, :, 0]

    def complement(self, group: int) -> tuple[IntArray, Array, Array]:
        """Columns ``(u,)`` that a group ties, its ``G (u, 3 g)`` and ``g (3 g,)``."""
        rows, which = self._groups.rows_of(group), self._groups.of_group(group)
        columns, at = np.unique(self._groups.column[rows], return_inverse=True)
        tall = np.zeros((len(columns), 3 * (which.stop - which.start)))
        right = 3 * (self._groups.of[rows] - which.start)[:, None, None] + np.arange(3)
        tall[at.reshape(-1, 6, 1), right] = self._across[rows]
        return columns, tall, self._right[which].ravel()

    def solution(self, step: Array) -> Array:
        """Steps ``(g, 3)`` of the landmarks of all groups, by those ``(columns,)`` of all else."""
        by_row = np.einsum("ri,rij->rj", step[self._groups.column], self._across)
        moved = self._right.copy()
        for axis in range(3):
            moved[:, axis] -= np.bincount(self._groups.of, by_row[:, axis], len(moved))
        return (moved[:, None, :] @ self._inverse)[:, 0]

    def covariances(self, group: int, tall: Array, sigma: Array) -> Array:
        """Covariances ``(g, 3, 3)`` of a group, by those ``(u, u)`` of the columns that it ties."""
        count = tall.shape[1] // 3
        spread = (sigma @ tall).reshape(len(tall), count, 3)
        inner = np.eye(3) + np.einsum("ugi,ugj->gij", tall.reshape(len(tall), count, 3), spread)
        inverse = self._inverse[self._groups.of_group(group)]
        return inverse.transpose(0, 2, 1) @ inner @ inverse

    def cross_covariances(self, group: int, tall: Array, sigma: Array) -> Array:
        """Covariances ``(g, 3, d)`` of a group with some columns, by those ``(u, d)`` of the ones it ties."""
        inverse = self._inverse[self._groups.of_group(group)]
        mixed = (tall.T @ sigma).reshape(len(inverse), 3, sigma.shape[1])
        return -inverse.transpose(0, 2, 1) @ mixed
