"""Cholesky factorisation of a long, narrow information matrix, one dense front after the other.

The frontal method (Irons, *A frontal solution program for finite element analysis*, IJNME 2, 1970; Duff,
Erisman and Reid, *Direct Methods for Sparse Matrices*, chapter 10) with columns in the order of time: what is
dense is the front, the columns from the elimination of their first neighbour to their own. All work is then
BLAS on a few hundred columns, and the elimination tree is a path.

The entries of the inverse within each front come from the last front back to the first (Takahashi, Fagan and
Chin, PICA 1973; for cliques Kaess and Dellaert, *Covariance recovery from a square root information matrix
for data association*, RAS 57, 2009). With the columns e that are eliminated in a front, those s that stay,
the factor ``L`` of the information of the former and ``Y = L^-1 H_es``:

    Sigma_es = -L^-T Y Sigma_ss,    Sigma_ee = L^-T (L^-1 - Y Sigma_se)
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from scipy.linalg import blas, lapack

from vislam.base.types import Array, IntArray

Assemble = Callable[[int, IntArray, Array, Array], None]
"""Adds what belongs to a front: by its number, the place of each column in it, and its matrix and right-hand
side, of which all columns that are eliminated in it are asked for, in the lower triangle."""


@dataclass(frozen=True)
class Front:
    """A front and, once it is eliminated, what is left of it.

    Attributes
    ----------
    columns : (a,)
        Those that are eliminated stand behind those that stay.
    stay : int
        How many stay.
    lower, across, right
        ``L (e, e)``, ``Y (e, s)`` and ``L^-1 b (e,)``.
    """

    columns: IntArray
    stay: int
    lower: Array
    across: Array
    right: Array


class Factorisation:
    """Square root of an information matrix, front by front.

    Parameters
    ----------
    begin : (n,)
        First front of each column; columns are in the order of their elimination.
    ends : (fronts + 1,)
        Front i eliminates the columns from ``ends[i]`` to ``ends[i + 1]``.
    assemble : callable

    Raises
    ------
    numpy.linalg.LinAlgError
        If the information is not positive definite.
    """

    def __init__(self, begin: IntArray, ends: IntArray, assemble: Assemble) -> None:
        # Place of each column in the front at hand.
        self._place = np.zeros(len(begin), np.int64)
        self._fronts: list[Front] = []
        by_begin = np.argsort(begin, kind="stable")
        begins = np.searchsorted(begin[by_begin], np.arange(len(ends)))
        stayed, left, left_right = np.empty(0, np.int64), np.zeros((0, 0)), np.zeros(0)
        for number in range(len(ends) - 1):
            active = np.concatenate([stayed, by_begin[begins[number] : begins[number + 1]]])
            stays = active >= ends[number + 1]
            columns = np.concatenate([active[stays], np.arange(ends[number], ends[number + 1])])
            at = self._placed(columns)[stayed]
            matrix, vector = np.zeros((len(columns), len(columns)), order="F"), np.zeros(len(columns))
            matrix[at[:, None], at], vector[at] = left, left_right
            assemble(number, self._place, matrix, vector)
            front = _eliminated(columns, int(np.count_nonzero(stays)), matrix, vector)
            self._fronts.append(front)
            stayed = columns[: front.stay]
            left = matrix[: front.stay, : front.stay] - front.across.T @ front.across
            left_right = vector[: front.stay] - front.across.T @ front.right

    def solve(self) -> Array:
        """Solution ``(n,)`` of the normal equations."""
        solution = np.zeros(len(self._place))
        for front in reversed(self._fronts):
            if not front.right.size:
                continue
            rest = front.right - front.across @ solution[front.columns[: front.stay]]
            solution[front.columns[front.stay :]] = blas.dtrsv(front.lower, rest, lower=1, trans=1)
        return solution

    def covariances(self) -> Iterator[tuple[int, IntArray, Array]]:
        """Number of each front, place of its columns and covariance ``(a, a)``, from the last to the first.

        The array of places ``(n,)`` is the same one each time, and holds for the columns of the front only.
        """
        sigma = np.zeros((0, 0))
        for number in range(len(self._fronts) - 1, -1, -1):
            front = self._fronts[number]
            at = self._place[front.columns[: front.stay]]
            known = sigma[np.ix_(at, at)]
            inverse = lapack.dtrtri(front.lower, lower=1)[0] if front.right.size else front.lower
            back = inverse.T @ front.across
            cross = back @ known
            sigma = np.empty((len(front.columns), len(front.columns)))
            sigma[: front.stay, : front.stay] = known
            sigma[front.stay :, : front.stay], sigma[: front.stay, front.stay :] = -cross, -cross.T
            sigma[front.stay :, front.stay :] = inverse.T @ inverse + cross @ back.T
            yield number, self._placed(front.columns), sigma

    def _placed(self, columns: IntArray) -> IntArray:
        self._place[columns] = np.arange(len(columns))
        return self._place


def _eliminated(columns: IntArray, stay: int, matrix: Array, vector: Array) -> Front:
    if stay == len(columns):
        # LAPACK takes no empty matrix: a frame whose variables are all eliminated last.
        return Front(columns, stay, np.zeros((0, 0)), np.zeros((0, stay)), np.zeros(0))
    lower, info = lapack.dpotrf(matrix[stay:, stay:], lower=1, clean=1)
    if info:
        raise np.linalg.LinAlgError("the information is not positive definite")
    across = blas.dtrsm(1.0, lower, matrix[stay:, :stay], lower=1)
    return Front(columns, stay, lower, across, blas.dtrsv(lower, vector[stay:], lower=1))
