"""The measurement of many landmarks, in the coordinates of their observations.

A stereo observation of a landmark has as many components as the landmark. So where each landmark is its
three coordinates, the observation itself, ``y = H_x x + H_l l`` with ``H_l`` square and block-diagonal, can
stand for ``l`` in the error of the state. It is measured with the white noise R alone, ``S = P_yy + R``, and
with ``V = S^-1``, r being all else of the state and ``C = P_yr``, the update is

    P_yy <- R - R V R,    P_yr <- R V C,    P_rr <- P_rr - C^T V C.

Of what grows with the cube of the landmarks that leaves the Cholesky factor and the inverse, m^3 operations
for m rows, where ``P - (L^-1 H P)^T (L^-1 H P)`` takes a third of that for L, m^2 d for the triangular
solution and m d^2 for the product, d >= m being the size of the state: 7/3 m^3 or more. Back to l by
``l = A (y - H_x x)``, ``A = H_l^-1``: block-diagonal and of the rank of x.

R - R V R is a difference of what is known before and after; its smallest eigenvalue is R over one more than
the number of observations so far, so it loses no more digits than that number has. Where S is large, as along
what the pose does to all observations, V is small and its rounding is not; so ``V C`` is solved for with the
factor, as the gain is of what all observations share.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dgemm, dtrsm
from scipy.linalg.lapack import dpotri

from vislam.base.types import Array, IntArray
from vislam.estimators.ekf.layout import COORDINATES
from vislam.estimators.ekf.linear import Correction, Jacobian, Told, cholesky, diagonal_blocks, mirror

WORTH = 300
"""Rows of a measurement from which on this update takes less time than the other."""
_WORST = 1e6
"""Condition of an ``H_l`` beyond which the other update is taken."""


@dataclass(frozen=True)
class ObservedUpdate(Correction):
    """Measurement of landmarks of three coordinates each.

    Attributes
    ----------
    jacobian : Jacobian
    variance, innovation : (m,)
        R and what was measured less what was predicted.
    weighted : (m,)
        ``V innovation``.
    precision : (m, m)
        V.
    cross, solved : (m, r)
        C and ``V C``.
    loss : (r, r)
        ``C^T V C``, symmetric to the last bit.
    rest, observed : (r,), (m,)
        Rows of the state that r and l are, the navigation state first.
    by_observation : (n, 3, 3)
        A.
    log_determinant : float
        Of S.
    """

    jacobian: Jacobian
    variance: Array
    innovation: Array
    weighted: Array
    precision: Array
    cross: Array
    solved: Array
    loss: Array
    rest: IntArray
    observed: IntArray
    by_observation: Array
    log_determinant: float

    @classmethod
    def fits(cls, jacobian: Jacobian) -> bool:
        """Whether it can be taken, and pays."""
        rows, blocks = len(jacobian.by_nav), jacobian.by_landmark
        if rows < WORTH or rows != 3 * len(blocks) or blocks.shape[2] != COORDINATES:
            return False
        singular = np.linalg.svd(blocks, compute_uv=False)
        return bool((singular[:, -1] * _WORST > singular[:, 0]).all())

    @classmethod
    def of(
        cls, jacobian: Jacobian, projected: Array, spread: Array, innovation: Array, *, variance: Array
    ) -> "ObservedUpdate":
        """Prepare an update from ``H P (m, d)`` and ``S (m, m)``, which is used up.

        Raises
        ------
        DivergedError
            If S is not positive definite.
        """
        n, _, size = jacobian.by_landmark.shape
        slots = np.arange(n) if jacobian.slots is None else jacobian.slots
        observed = (jacobian.nav + size * slots[:, None] + np.arange(size)).reshape(-1)
        others = np.ones(projected.shape[1], bool)
        others[observed] = False
        rest = np.flatnonzero(others)
        factor = cholesky(spread, jacobian, projected)
        log_det = 2.0 * float(np.log(np.diagonal(factor)).sum())
        cross = projected.take(rest, axis=1)
        whitened = dtrsm(1.0, factor, np.column_stack([cross, innovation]), lower=1)
        loss = whitened[:, :-1].T @ whitened[:, :-1]
        solved = dtrsm(1.0, factor, whitened, lower=1, trans_a=1)
        inverse, _ = dpotri(factor, lower=1, overwrite_c=1)
        return cls(
            jacobian,
            variance,
            innovation,
            solved[:, -1],
            mirror(inverse.T),
            cross,
            solved[:, :-1],
            loss,
            rest,
            observed,
            np.asarray(np.linalg.inv(jacobian.by_landmark), dtype=np.float64),
            log_det,
        )

    def pull(self) -> Array:
        """``S^-1 innovation``, ``(m,)``."""
        return self.weighted

    @property
    def inverse(self) -> Array:
        """``S^-1``, ``(m, m)``."""
        return self.precision

    def predicted(self) -> tuple[Array, Array]:
        """Innovation ``(m,)`` and the lower Cholesky factor ``(m, m)`` of its covariance S."""
        return self.innovation, np.linalg.cholesky(np.linalg.inv(self.precision))

    @property
    def log_det(self) -> float:
        """Logarithm of the determinant of S."""
        return self.log_determinant

    @property
    def nis(self) -> float:
        """Normalised innovation squared."""
        return float(self.innovation @ self.weighted)

    @property
    def correction(self) -> Array:
        """``K innovation``, ``(d,)``."""
        out = np.empty(len(self.rest) + len(self.observed))
        rest = self.innovation @ self.solved
        out[self.rest] = rest
        moved = self.innovation - self.variance * self.weighted - self.jacobian.by_nav @ rest[: self._seen]
        out[self.observed] = (self.by_observation @ moved.reshape(-1, 3, 1)).reshape(-1)
        return out

    @property
    def gain(self) -> Array:
        """``K^T``, ``(m, d)``: of y it is ``1 - V R``, of r ``V C``."""
        m = len(self.variance)
        out = np.empty((len(self.rest) + m, m))
        out[self.rest] = self.solved.T
        of_y = self.jacobian.by_nav @ self.solved[:, : self._seen].T
        of_y += self.variance[:, None] * self.precision
        np.negative(of_y, out=of_y)
        of_y.reshape(-1)[:: m + 1] += 1.0
        out[self.observed] = _blocks_times(self.by_observation, of_y)
        return out.T

    @property
    def white(self) -> Array:
        """Variances ``(m,)`` of the white noise [px^2]."""
        return self.variance

    def forward(self, cov: Array) -> None:
        """Set the covariance to that after the update; symmetric to rounding."""
        seen, scale = self._seen, self.by_observation * self.variance.reshape(-1, 1, 3)
        rest = cov[np.ix_(self.rest, self.rest)] - self.loss
        by_nav = (self.by_observation @ self.jacobian.by_nav.reshape(-1, 3, seen)).reshape(-1, seen)
        scaled = _blocks_times(scale, self.solved)
        half = scaled[:, :seen] - 0.5 * (by_nav @ rest[:seen, :seen])
        own = _blocks_times(scale, _blocks_times(scale, self.precision).T)
        # G half^T + half G^T, G = A H_x, in place: what Fortran takes for the transpose is the same matrix.
        left, right = np.hstack([by_nav, half]), np.hstack([half, by_nav])
        own = dgemm(-1.0, left.T, right.T, beta=-1.0, c=own.T, trans_a=1, overwrite_c=1).T
        diagonal_blocks(own, 3)[...] += scale @ self.by_observation.transpose(0, 2, 1)
        cross = scaled - by_nav @ rest[:seen]
        cov[np.ix_(self.rest, self.rest)] = rest
        cov[np.ix_(self.observed, self.rest)] = cross
        cov[np.ix_(self.rest, self.observed)] = cross.T
        first, last = self.observed[0], self.observed[-1] + 1
        if last - first == len(own):
            cov[first:last, first:last] = own
        else:
            cov[np.ix_(self.observed, self.observed)] = own

    def tell(self, rows: Array) -> Told:
        """What it says of quantities whose covariance with the state is ``rows (k, d)``."""
        seen = self.jacobian.times(rows.T).T
        solved = seen @ self.precision
        out = np.empty(rows.shape)
        rest = rows[:, self.rest] - seen @ self.solved
        out[:, self.rest] = rest
        of_y = solved * self.variance - rest[:, : self._seen] @ self.jacobian.by_nav.T
        out[:, self.observed] = _blocks_times(self.by_observation, of_y.T).T
        return Told(seen @ self.weighted, seen, solved, out)

    @property
    def nbytes(self) -> int:
        """Memory that it holds [bytes]."""
        held = self.jacobian
        return super().nbytes + held.by_nav.nbytes + held.by_landmark.nbytes

    @property
    def _seen(self) -> int:
        """Components of the navigation state that the observations depend on."""
        return self.jacobian.by_nav.shape[1]


def _blocks_times(blocks: Array, matrix: Array) -> Array:
    """Product ``(3n, k)`` of a block-diagonal matrix, its blocks ``(n, 3, 3)``, with ``(3n, k)``."""
    n, columns = len(blocks), matrix.shape[1]
    return (blocks @ matrix.reshape(n, 3, columns)).reshape(3 * n, columns)
