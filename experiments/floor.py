"""Part ``floor``: the filter's own BLAS and LAPACK calls, on matrices of the same sizes, and nothing else.

What counts, forward: the navigation products of prediction, ``H P`` and ``H P H^T`` with one small product
a landmark and dense navigation columns, dpotrf, dtrsm, dtrsv, ``W^T W`` and its subtraction, ``W^T w``, the
products of appending, and those of the landmarks' new coordinates (``invariant``). Backward: dtrsm,
``K^T N``, its product with K, dpotri, the products with ``H^T``, dtrsv, the products that map N and r back
over appending, prediction and new coordinates, and those that ask for landmarks and poses.

What does not: copies that cut and grow the covariance or fill in a triangle, sums of N, the gate, Jacobians,
everything in Python. Results go to memory that is there already.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg.blas import dtrsm, dtrsv
from scipy.linalg.lapack import dpotrf, dpotri
from threadpoolctl import threadpool_limits

from experiments.timing import Drive, FrameSizes, Part, quickest, timed
from vislam.base.types import Array
from vislam.estimators import ekf
from vislam.estimators.ekf import EkfOptions
from vislam.estimators.ekf.layout import COORDINATES, LANDMARK
from vislam.models.odometry import NAV as ODOMETRY

VARIANTS: Mapping[str, EkfOptions] = {name: EkfOptions(**ekf.VARIANTS[name]) for name in ("ekf", "eks")}
"""The variants that are timed: the standard filter, and the one that takes the most steps back."""
_POSE = 6
_VECTORS = 7
"""Columns of the adjoint's vectors."""


@dataclass(frozen=True)
class _Matrices:
    """Well-conditioned random matrices of a frame's sizes.

    Attributes
    ----------
    cov, out : (d, d)
        A covariance, and room for a result of its size; d with what the frame appends.
    wide : (m, d)
        Room for ``H P``, and its values.
    spread, factor : (m, m)
        A positive definite matrix, and a lower triangle; in Fortran's order.
    by_landmark, by_nav : (n, 3, s), (m, c)
        s being the size of a landmark's error, c the components of the navigation state that are observed.
    nav : int
        Components of the navigation state.
    """

    cov: Array
    out: Array
    wide: Array
    spread: Array
    factor: Array
    by_landmark: Array
    by_nav: Array
    nav: int


class Replay:
    """Replays frames of given sizes; each call returns the time of the linear algebra alone [s].

    Parameters
    ----------
    largest : int
        Landmarks of the largest state.
    options : EkfOptions
        Of the filter whose calls these are.
    nav, observed : int
        Components of the navigation state, and of these the ones that observations depend on.
    """

    def __init__(self, largest: int, options: EkfOptions, *, nav: int, observed: int) -> None:
        self._nav, self._observed = nav, observed
        generator = np.random.default_rng(0)
        self._landmark = COORDINATES if options.track_errors == "independent" else LANDMARK
        size = self._nav + self._landmark * largest
        self._invariant = options.error == "invariant"
        self._poses = options.smoothed
        self._random = 0.1 / size * generator.standard_normal((size, size))
        self._positive = np.eye(size) + self._random + self._random.T
        self._transition = self._positive[: self._nav, : self._nav].copy()
        self._by_landmark = generator.standard_normal((largest, 3, self._landmark))

    def forward(self, sizes: FrameSizes) -> float:
        """Time of a frame's step."""
        known, d = sizes.known, self._nav + self._landmark * sizes.known
        transition = self._transition
        all_seen, seen = self._matrices(known, d), self._matrices(sizes.fused, d)
        cov, out, innovation = all_seen.cov, all_seen.out, self._random[0, : 3 * sizes.fused].copy()
        appended = self._random[: self._landmark * sizes.new, : self._nav].copy()
        cross, own = np.empty((len(appended), d)), np.empty((len(appended), len(appended)))
        others = self._random[:d, : 2 * _POSE].copy()

        started = time.thread_time()
        np.matmul(transition, cov[: self._nav], out=out[: self._nav])
        np.matmul(out[: self._nav, : self._nav], transition.T)
        if known:
            _times(all_seen, cov, all_seen.wide)
            _times(all_seen, all_seen.wide.T, all_seen.spread.T)
        if sizes.fused:
            factor, _ = dpotrf(seen.spread, lower=1, clean=0, overwrite_a=1)
            gain = dtrsm(1.0, factor, seen.wide.T, side=1, lower=1, trans_a=1, overwrite_b=1).T
            whitened = dtrsv(factor, innovation, lower=1)
            np.matmul(gain.T, gain, out=out)
            np.subtract(cov, out, out=cov)
            np.matmul(whitened, gain)
            if self._invariant:
                np.matmul(others, others.T, out=out)
                np.add(cov, out, out=cov)
        if sizes.new:
            np.matmul(appended, cov[: self._nav], out=cross)
            np.matmul(cross[:, : self._nav], appended.T, out=own)
        return time.thread_time() - started

    def backward(self, sizes: FrameSizes) -> float:
        """Time of the backward pass over a frame."""
        after = self._nav + self._landmark * (sizes.known + sizes.new)
        d, gone = self._nav + self._landmark * sizes.known, 3 * (sizes.held - sizes.known)
        before = self._nav + self._landmark * sizes.held
        seen = self._matrices(sizes.fused, d)
        information, out, transition = seen.cov, seen.out, self._transition
        grown = self._square(after)
        vectors, all_vectors = self._random[:d, :_VECTORS].copy(), self._random[:after, :_VECTORS].copy()
        appended = self._random[: self._landmark * sizes.new, : self._nav].copy()
        landmarks = self._random[: d - self._nav, :_POSE].copy()
        inner, whitened = np.empty(seen.factor.shape), self._random[0, : 3 * sizes.fused].copy()
        tall, short = np.empty((d, 3 * sizes.fused)), np.empty((d, _VECTORS))
        asked_before, asked_after = self._random[:gone, :before].copy(), self._random[:_POSE, :after].copy()
        left, left_vectors = self._square(before), self._random[:before, :_VECTORS].copy()

        started = time.thread_time()
        if self._poses:
            _expected(asked_after, grown, all_vectors)
        if sizes.new:
            mixed = appended.T @ grown[d:]
            np.matmul(mixed[:, d:], appended)
            np.matmul(appended.T, all_vectors[d:])
        if sizes.fused:
            if self._invariant:
                np.matmul(landmarks.T, information[self._nav :])
                np.matmul(information[:, self._nav :], landmarks)
                np.matmul(landmarks.T, vectors[self._nav :])
            gain = dtrsm(1.0, seen.factor, seen.wide.T, side=1, lower=1, overwrite_b=1).T
            product = gain @ information
            np.matmul(product, gain.T, out=inner)
            dpotri(seen.factor, lower=1, overwrite_c=1)
            _transposed_times(seen, inner, tall)
            _transposed_times(seen, product, out)
            later = gain @ vectors
            dtrsv(seen.spread, whitened, lower=1, trans=1)
            _transposed_times(seen, later, short)
        np.matmul(transition.T, information[: self._nav], out=out[: self._nav])
        np.matmul(information[:, : self._nav], transition, out=out[:, : self._nav])
        np.matmul(transition.T, vectors[: self._nav])
        if gone:
            _expected(asked_before, left, left_vectors)
        return time.thread_time() - started

    def _square(self, size: int) -> Array:
        return self._positive[:size, :size].copy()

    def _matrices(self, landmarks: int, size: int) -> _Matrices:
        m = 3 * landmarks
        return _Matrices(
            cov=self._square(size),
            out=np.zeros((size, size)),
            wide=self._random[:m, :size].copy(),
            spread=self._positive[:m, :m].copy(order="F"),
            factor=self._positive[:m, :m].copy(order="F"),
            by_landmark=self._by_landmark[:landmarks],
            by_nav=self._random[:m, : self._observed].copy(),
            nav=self._nav,
        )


def measure(drive: Drive, *, repeats: int) -> Part:
    """Run each variant over a sequence, and then its linear algebra alone."""
    rows: list[list[str]] = []
    values: dict[str, dict[str, float]] = {}
    for variant, options in VARIANTS.items():
        with threadpool_limits(1):
            run = quickest([timed(drive, options) for _ in range(repeats)])
        whole = ekf.EkfEstimator(drive.problem, options).state.layout.size
        for name, nav, observed in (("", ODOMETRY, ODOMETRY), ("_own_size", whole, _POSE)):
            forward, backward = replay(run.sizes, options, repeats=repeats, nav=nav, observed=observed)
            ratios = run.forward / forward, run.backward / backward
            passes = ((run.forward, forward), (run.backward, backward))
            told = [f"{taken:.2f} / {least:.2f}" for taken, least in passes]
            rows.append([variant, str(nav), told[0], f"{ratios[0]:.2f}", told[1], f"{ratios[1]:.2f}"])
            values[variant + name] = {"forward_ratio": ratios[0], "backward_ratio": ratios[1]}
    return Part(
        title=f"floor: {drive.name}, the filter against its own linear algebra, 1 BLAS thread",
        header=[
            "member",
            "navigation",
            "forward, its floor [s]",
            "ratio",
            "backward, its floor [s]",
            "ratio",
        ],
        rows=rows,
        notes=(
            f"least times of {repeats} repeats on both sides",
            "navigation: components of the state that the linear algebra has beside landmarks, those of pose"
            " and bias or all that the filter has; of all, observations depend on the pose alone",
        ),
        values=values,
    )


def replay(
    sizes: Sequence[FrameSizes],
    options: EkfOptions,
    *,
    repeats: int,
    nav: int = ODOMETRY,
    observed: int = ODOMETRY,
) -> tuple[float, float]:
    """Floor of the forward and of the backward pass [s]."""
    largest = max(max(each.held, each.known + each.new) for each in sizes)
    machine = Replay(largest, options, nav=nav, observed=observed)
    with threadpool_limits(1):
        forward = [[machine.forward(each) for each in sizes] for _ in range(repeats)]
        backward = [sum(machine.backward(each) for each in reversed(sizes)) for _ in range(repeats)]
    return float(np.min(forward, axis=0).sum()), min(backward)


def _times(jacobian: _Matrices, matrix: Array, out: Array) -> None:
    """``H A``."""
    (n, _, size), columns = jacobian.by_landmark.shape, matrix.shape[1]
    blocks = matrix[jacobian.nav :].reshape(n, size, columns)
    np.matmul(jacobian.by_landmark, blocks, out=out.reshape(n, 3, columns))
    out += jacobian.by_nav @ matrix[: jacobian.by_nav.shape[1]]


def _transposed_times(jacobian: _Matrices, matrix: Array, out: Array) -> None:
    """``H^T A``."""
    (n, _, size), columns = jacobian.by_landmark.shape, matrix.shape[1]
    np.matmul(jacobian.by_nav.T, matrix, out=out[: jacobian.by_nav.shape[1]])
    blocks = out[jacobian.nav : jacobian.nav + size * n].reshape(n, size, columns)
    np.matmul(jacobian.by_landmark.transpose(0, 2, 1), matrix.reshape(n, 3, columns), out=blocks)


def _expected(rows: Array, information: Array, vectors: Array) -> None:
    """What is asked of the adjoint for some rows."""
    np.matmul(rows, vectors)
    np.matmul(rows @ information, rows.T)
