"""The linear steps that the filter takes with its error, forward on the covariance and back on the adjoint.

Forward, the covariance P of the joint error. Back, what the data that came later say about the error x at a
time: the adjoint r and its information N, so that, given all data (modified Bryson-Frazier),

    x_hat = P r,    cov = P - P N P,    cross-covariance with the last pose = P Psi.

G. J. Bierman, *Fixed interval smoothing with discrete measurements*, Int. J. Control 18 (1973) 65-75; for the
notation see de Jong, *Smoothing and interpolation with the state-space model*, JASA 84 (1989). Each step maps
them by the transpose of what it does to the error, and only a measurement adds to them. No step needs the
inverse of a covariance.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg.blas import dgemm, dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf, dpotri

from vislam.base.errors import DivergedError
from vislam.base.types import Array, BoolArray, IntArray
from vislam.models.odometry import POSE

_BLOCK = 64
_LOWER = np.tri(_BLOCK, k=-1, dtype=bool)
_WIDE = 256
"""Rows of a product that BLAS takes at full speed."""
_FEW = 16
"""Rows of a measurement up to which reading and writing the covariance takes longer than the product."""


@dataclass
class Adjoint:
    """Adjoint (information vector and matrix) of later data at one time.

    Attributes
    ----------
    information : (d, d)
        N.
    vectors : (d, 7)
        r, and the six columns of Psi.
    """

    information: Array
    vectors: Array

    @classmethod
    def of_the_last(cls, size: int) -> "Adjoint":
        """Adjoint after the last step: zero."""
        vectors = np.zeros((size, 7))
        vectors[POSE, 1:] = np.eye(6)
        return cls(np.zeros((size, size)), vectors)

    def expected(self, rows: Array) -> tuple[Array, Array, Array]:
        """Smoothed error of some rows: mean, reduction of covariance, cross-covariance.

        Parameters
        ----------
        rows : (..., k, d)
            Covariance of k quantities, linear in the error, with the whole error.

        Returns
        -------
        mean : (..., k)
        loss : (..., k, k)
            By how much their covariance is smaller than without later data.
        cross : (..., k, 6)
            Their covariance with the last pose.
        """
        # As one matrix each, for a product a group of quantities would not keep BLAS busy.
        flat = rows.reshape(-1, rows.shape[-1])
        found = (flat @ self.vectors).reshape(*rows.shape[:-1], -1)
        seen = (flat @ self.information).reshape(rows.shape)
        return found[..., 0], seen @ np.swapaxes(rows, -1, -2), found[..., 1:]


class Step:
    """One linear step of the error; what a subclass holds is what the backward pass needs."""

    def back(self, after: Adjoint) -> Adjoint:
        """Adjoint before the step from that after it, which may be used up; the same if the error stays."""
        return after

    @property
    def nbytes(self) -> int:
        """Memory that it holds [bytes]."""
        total = 0
        for value in vars(self).values():
            if type(value) is np.ndarray:
                total += value.nbytes
        return total


@dataclass(frozen=True)
class Jacobian:
    """H of a measurement: dense columns for the navigation state, one block a landmark.

    Attributes
    ----------
    by_nav : (m, c)
        By the first c components of the navigation state; it does not depend on the others.
    by_landmark : (n, 3, s)
        Of the first 3n rows, s being the size of a landmark's error; m - 3n further rows see no landmark.
    slots : (n,) or None
        Which landmarks these are; None for all, in order.
    nav : int
        Size of the navigation state.
    """

    by_nav: Array
    by_landmark: Array
    slots: IntArray | None
    nav: int

    def times(self, matrix: Array) -> Array:
        """``H A``, ``(m, k)``, for ``A (d, k)``."""
        (n, _, size), columns = self.by_landmark.shape, matrix.shape[1]
        of_nav = matrix[: self.by_nav.shape[1]]
        if not n:
            return self.by_nav @ of_nav
        blocks = matrix[self.nav :].reshape(-1, size, columns)
        if self.slots is not None:
            blocks = blocks[self.slots]
        out = np.empty((len(self.by_nav), columns))
        out[3 * n :] = 0.0
        np.matmul(self.by_landmark, blocks, out=out[: 3 * n].reshape(n, 3, columns))
        # In place, for the transpose of a C-ordered matrix is what Fortran wants.
        return dgemm(1.0, of_nav.T, self.by_nav.T, beta=1.0, c=out.T, overwrite_c=1).T

    def transposed_times(self, matrix: Array, *, size: int) -> Array:
        """``H^T A``, ``(d, k)``, for ``A (m, k)``."""
        (n, _, own), columns, seen = self.by_landmark.shape, matrix.shape[1], self.by_nav.shape[1]
        out = np.empty((size, columns))
        np.matmul(self.by_nav.T, matrix, out=out[:seen])
        out[seen : self.nav] = 0.0
        if not n:
            out[self.nav :] = 0.0
            return out
        blocks = out[self.nav :].reshape(-1, own, columns)
        found = self.by_landmark.transpose(0, 2, 1) @ matrix[: 3 * n].reshape(n, 3, columns)
        if self.slots is None:
            blocks[...] = found
        else:
            blocks[...] = 0.0
            blocks[self.slots] = found
        return out


@dataclass(frozen=True)
class Told:
    """What a measurement says of k quantities that are no part of the state.

    Attributes
    ----------
    correction : (k,)
    left, right : (k, m)
        ``left right^T`` is what their covariance loses.
    rows : (k, d)
        Their covariance with the state afterwards.
    """

    correction: Array
    left: Array
    right: Array
    rows: Array


class Correction(Step):
    """Measurement, ``x <- x + K (innovation - H x)`` (Barfoot 2017, 4.2.3; course report, eqs. 28, 29).

    A subclass says in which form it holds the gain.
    """

    jacobian: Jacobian

    def pull(self) -> Array:
        """``S^-1 innovation``, ``(m,)``."""
        raise NotImplementedError

    @property
    def gain(self) -> Array:
        """``K^T = S^-1 H P``, ``(m, d)``."""
        raise NotImplementedError

    @property
    def inverse(self) -> Array:
        """``S^-1``, ``(m, m)``."""
        raise NotImplementedError

    @property
    def white(self) -> Array:
        """Variances ``(m,)`` of the white noise, ``S - H P H^T`` [px^2]."""
        raise NotImplementedError

    def predicted(self) -> tuple[Array, Array]:
        """Innovation ``(m,)`` and the lower Cholesky factor ``(m, m)`` of its covariance S."""
        raise NotImplementedError

    @property
    def nis(self) -> float:
        """Normalised innovation squared."""
        raise NotImplementedError

    @property
    def log_det(self) -> float:
        """Logarithm of the determinant of S."""
        raise NotImplementedError

    @property
    def correction(self) -> Array:
        """``K innovation``, ``(d,)``."""
        raise NotImplementedError

    def forward(self, cov: Array) -> None:
        """Set the covariance to that after the update."""
        raise NotImplementedError

    def tell(self, rows: Array) -> Told:
        """What it says of quantities whose covariance with the state is ``rows (k, d)``."""
        raise NotImplementedError

    def back(self, after: Adjoint) -> Adjoint:
        """``N <- H^T S^-1 H + (1 - K H)^T N (1 - K H)``, ``r <- H^T S^-1 innovation + (1 - K H)^T r``."""
        size, gain = len(after.vectors), self.gain
        seen = gain @ after.information
        inner = symmetric_product(seen, gain)
        inner += self.inverse
        # With V = (C + S^-1) H / 2 - K^T N, the sum of H^T V and its transpose is all that N changes by.
        np.negative(seen, out=seen)
        half = self.jacobian.transposed_times(inner, size=size)
        half *= 0.5
        seen += half.T
        change = self.jacobian.transposed_times(seen, size=size)
        after.information += change
        after.information += change.T
        later = -(gain @ after.vectors)
        later[:, 0] += self.pull()
        after.vectors += self.jacobian.transposed_times(later, size=size)
        return after


@dataclass(frozen=True)
class Update(Correction):
    """Measurement by the whitened gain: ``P - W^T W``.

    Attributes
    ----------
    jacobian : Jacobian
    factor : (m, m)
        Lower Cholesky factor L of the innovation covariance S; its upper half is not looked at.
    whitened_gain : (m, d)
        ``W = L^-1 H P``, so that ``K = W^T L^-1``.
    whitened : (m,)
        ``L^-1 innovation``.
    """

    jacobian: Jacobian
    factor: Array
    whitened_gain: Array
    whitened: Array

    @classmethod
    def of(cls, jacobian: Jacobian, projected: Array, spread: Array, innovation: Array) -> "Update":
        """Prepare an update from ``H P (m, d)`` and ``S (m, m)``, which are both used up.

        Raises
        ------
        DivergedError
            If S is not positive definite.
        """
        factor = cholesky(spread, jacobian, projected)
        # From the right, since the transpose of a C-ordered matrix is what Fortran wants.
        gain = dtrsm(1.0, factor, projected.T, side=1, lower=1, trans_a=1, overwrite_b=1)
        return cls(jacobian, factor, gain.T, dtrsv(factor, innovation, lower=1))

    @property
    def gain(self) -> Array:
        """``K^T = L^-T W``, ``(m, d)``."""
        return dtrsm(1.0, self.factor, self.whitened_gain.T, side=1, lower=1).T

    @property
    def inverse(self) -> Array:
        """``S^-1``, ``(m, m)``."""
        inverse, _ = dpotri(self.factor, lower=1)
        return mirror(inverse.T)

    def pull(self) -> Array:
        """``S^-1 innovation``, ``(m,)``."""
        return dtrsv(self.factor, self.whitened, lower=1, trans=1)

    @property
    def white(self) -> Array:
        """Variances ``(m,)`` of the white noise [px^2]."""
        factor = np.tril(self.factor)
        by_state = self.jacobian.times((factor @ self.whitened_gain).T)
        return np.asarray(np.sum(factor**2, axis=1) - np.diagonal(by_state))

    def predicted(self) -> tuple[Array, Array]:
        """Innovation ``(m,)`` and the lower Cholesky factor ``(m, m)`` of its covariance S."""
        factor = np.tril(self.factor)
        return factor @ self.whitened, factor

    @property
    def nis(self) -> float:
        """Normalised innovation squared."""
        return float(self.whitened @ self.whitened)

    @property
    def log_det(self) -> float:
        """Logarithm of the determinant of S."""
        return 2.0 * float(np.log(self.factor.diagonal()).sum())

    @property
    def correction(self) -> Array:
        """``K innovation``, ``(d,)``."""
        return self.whitened @ self.whitened_gain

    def forward(self, cov: Array) -> None:
        """Take ``W^T W`` off the covariance: symmetric to the last bit."""
        gain = self.whitened_gain
        if len(gain) > _FEW:
            cov -= gain.T @ gain
            return
        # In one pass over cov, which is its own transpose; with few rows that is more than half the product.
        out = dgemm(-1.0, gain.T, gain.T, beta=1.0, c=cov.T, trans_b=1, overwrite_c=1)
        if not np.may_share_memory(out, cov):
            cov[...] = out.T

    def tell(self, rows: Array) -> Told:
        """What it says of quantities whose covariance with the state is ``rows (k, d)``."""
        seen = self.jacobian.times(rows.T)
        # C H^T L^-T, from the right as in Update.of.
        gain = dtrsm(1.0, self.factor, seen.T, side=1, lower=1, trans_a=1, overwrite_b=1)
        return Told(gain @ self.whitened, gain, gain, rows - gain @ self.whitened_gain)

    @property
    def nbytes(self) -> int:
        """Memory that it holds [bytes]."""
        held = self.jacobian
        return super().nbytes + held.by_nav.nbytes + held.by_landmark.nbytes


def cholesky(spread: Array, jacobian: Jacobian, projected: Array) -> Array:
    """Lower Cholesky factor of ``S (m, m)``, which is used up; its upper half is not to be looked at.

    Raises
    ------
    DivergedError
        If S is not positive definite.
    """
    factor, failed = dpotrf(spread.T, lower=1, clean=0, overwrite_a=1)
    if failed:
        smallest = float(np.linalg.eigvalsh(jacobian.times(projected.T))[0])
        raise DivergedError(f"innovation covariance lost, smallest eigenvalue of H P H' is {smallest:.3g}")
    return factor


def diagonal_blocks(matrix: Array, size: int) -> Array:
    """Blocks ``(n, size, size)`` on the diagonal of a C-ordered matrix, to be written to as well."""
    n = len(matrix) // size
    return np.einsum("iaib->iab", matrix.reshape(n, size, n, size))


def squared_distances(cov: Array, variance: Array, value: Array) -> Array:
    """Squared Mahalanobis distances ``(n,)`` of vectors of three, by ``L D L^T`` of each covariance.

    Parameters
    ----------
    cov : (n, 3, 3)
        Of which the lower half is read.
    variance : (n, 3)
        What is added to its diagonals.
    value : (n, 3)
    """
    x, y, z = value.T
    a, b, c = variance.T
    yx, zx = cov[:, 1, 0], cov[:, 2, 0]
    first = cov[:, 0, 0] + a
    of_y, of_z = yx / first, zx / first
    second = cov[:, 1, 1] + b - of_y * yx
    zy = cov[:, 2, 1] - of_z * yx
    third = cov[:, 2, 2] + c - of_z * zx - zy * zy / second
    y = y - of_y * x
    z = z - of_z * x - zy / second * y
    return np.asarray(x * x / first + y * y / second + z * z / third)


def symmetric_product(left: Array, right: Array) -> Array:
    """``A B^T (m, m)`` of matrices ``(m, k)`` whose product is symmetric: of many rows, one half is taken."""
    rows = len(left)
    if rows < 2 * _WIDE:
        return left @ right.T
    out = np.empty((rows, rows))
    for start in range(0, rows, _WIDE):
        own, stop = slice(start, start + _WIDE), min(start + _WIDE, rows)
        np.matmul(left[own], right[:stop].T, out=out[own, :stop])
        out[:start, own] = out[own, :start].T
    return out


def mirror(upper: Array) -> Array:
    """Fill in the lower half of a symmetric matrix ``(m, m)`` from the upper one, in place; returns it."""
    for start in range(0, len(upper), _BLOCK):
        own = slice(start, start + _BLOCK)
        block = upper[own, own]
        np.copyto(block, block.T, where=_LOWER[: len(block), : len(block)])
        upper[own.stop :, own] = upper[own, own.stop :].T
    return upper


@dataclass(frozen=True)
class Move(Step):
    """Motion of the navigation state, ``x <- F x + w`` (Barfoot 2017, 4.2.3; course report, eq. 25).

    Attributes
    ----------
    transition : (d_nav, d_nav)
        F.
    """

    transition: Array

    def forward(self, cov: Array, noise: Array) -> None:
        """``F P F^T``, plus the ``noise (d_nav, d_nav)``."""
        nav = len(self.transition)
        moved = self.transition @ cov[:nav]
        cov[:nav, nav:] = moved[:, nav:]
        cov[nav:, :nav] = moved[:, nav:].T
        np.add(moved[:, :nav] @ self.transition.T, noise, out=cov[:nav, :nav])

    def back(self, after: Adjoint) -> Adjoint:
        """``N <- F^T N F``."""
        information, nav = after.information, len(self.transition)
        information[:nav] = self.transition.T @ information[:nav]
        information[:, :nav] = information[:, :nav] @ self.transition
        after.vectors[:nav] = self.transition.T @ after.vectors[:nav]
        return after


@dataclass(frozen=True)
class Reset(Step):
    """New coordinates of the error: ``rest <- rest + B pose``, then ``pose <- A pose``.

    Attributes
    ----------
    pose : (6, 6)
        A.
    rest : (k, 6) or None
        B, of the last k components, all of them behind the pose; None for zero.
    """

    pose: Array
    rest: Array | None

    def forward(self, cov: Array) -> None:
        """``M P M^T``."""
        if self.rest is None:
            cov[POSE] = self.pose @ cov[POSE]
            cov[:, POSE] = cov[:, POSE] @ self.pose.T
            return
        # M = 1 + U E^T, E picking the pose: U (P E)^T + (P E) U^T + U E^T P E U^T as a single product.
        by_pose = self._by_pose(len(cov))
        half = cov[:, POSE] + 0.5 * (by_pose @ cov[POSE, POSE])
        left, right = np.hstack([by_pose, half]), np.hstack([half, by_pose])
        # In place where cov^T is of Fortran's order; what is added to it is as symmetric as cov.
        out = dgemm(1.0, right.T, left.T, beta=1.0, c=cov.T, trans_a=1, overwrite_c=1)
        if not np.may_share_memory(out, cov):
            cov[...] = out.T

    def back(self, after: Adjoint) -> Adjoint:
        """``N <- M^T N M``."""
        information, vectors = after.information, after.vectors
        if self.rest is None:
            information[POSE] = self.pose.T @ information[POSE]
            information[:, POSE] = information[:, POSE] @ self.pose
            vectors[POSE] = self.pose.T @ vectors[POSE]
            return after
        by_pose = self._by_pose(len(vectors))
        change = information @ by_pose
        information[:, POSE] += change
        change[POSE] += by_pose.T @ change
        information[POSE] += change.T
        vectors[POSE] += by_pose.T @ vectors
        return after

    def _by_pose(self, size: int) -> Array:
        """What is added to an error by its pose, ``M - 1 (d, 6)``; all other columns are zero."""
        assert self.rest is not None
        out = np.zeros((size, 6))
        out[POSE] = self.pose
        out.reshape(-1)[:36:7] -= 1.0
        out[size - len(self.rest) :] = self.rest
        return out


@dataclass(frozen=True)
class Append(Step):
    """New landmarks as functions of the navigation state: ``x <- (x, G x + noise)``.

    Attributes
    ----------
    by_nav : (k, c)
        G, of the first c components of the navigation state; they are no functions of the others.
    """

    by_nav: Array

    def forward(self, cov: Array, noise: Array) -> Array:
        """Grow the covariance; ``noise (n, s, s)`` is that of each new landmark."""
        size, (added, seen) = len(cov), self.by_nav.shape
        out = np.empty((size + added, size + added))
        out[:size, :size] = cov
        cross = np.matmul(self.by_nav, cov[:seen], out=out[size:, :size])
        out[:size, size:] = cross.T
        own = np.matmul(cross[:, :seen], self.by_nav.T, out=out[size:, size:])
        blocks = diagonal_blocks(own, noise.shape[1])
        blocks += noise
        return out

    def back(self, after: Adjoint) -> Adjoint:
        """``N <- G^T N G`` on the navigation state, the rest as it was."""
        size, seen = len(after.vectors) - len(self.by_nav), self.by_nav.shape[1]
        information = after.information[:size, :size].copy()
        mixed = self.by_nav.T @ after.information[size:]
        information[:seen] += mixed[:, :size]
        information[:, :seen] += mixed[:, :size].T
        information[:seen, :seen] += mixed[:, size:] @ self.by_nav
        vectors = after.vectors[:size].copy()
        vectors[:seen] += self.by_nav.T @ after.vectors[size:]
        return Adjoint(information, vectors)


@dataclass(frozen=True)
class Keep(Step):
    """Marginalise: only some components of the error stay.

    Attributes
    ----------
    rows : (d,)
        Which.
    """

    rows: BoolArray

    @cached_property
    def kept(self) -> IntArray:
        """The same, by number."""
        return np.flatnonzero(self.rows)

    def forward(self, cov: Array) -> Array:
        """Cut the other rows and columns out."""
        return cov.take(self.kept, axis=0).take(self.kept, axis=1)

    def back(self, after: Adjoint) -> Adjoint:
        """Nothing more is said directly of what has gone."""
        kept = len(after.vectors)
        # What has gone is read from a row and a column of zeros at the end.
        source = np.where(self.rows, np.cumsum(self.rows) - 1, kept)
        information = np.zeros((kept + 1, kept + 1))
        information[:kept, :kept] = after.information
        vectors = np.zeros((kept + 1, after.vectors.shape[1]))
        vectors[:kept] = after.vectors
        return Adjoint(information.take(source, axis=0).take(source, axis=1), vectors.take(source, axis=0))
