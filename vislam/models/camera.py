"""One camera with its lens: rays to pixels and back, vectorised over points.

Both lens models are those of OpenCV and Kalibr, by the same names of coefficients: radial-tangential (Brown
1966) and Kannala-Brandt (Kannala and Brandt, *A generic camera model and calibration method*, PAMI 2006, eq.
6 with four terms), which Kalibr calls ``equidistant``.
"""

from dataclasses import dataclass
from enum import Enum

import numpy as np

from vislam.base.types import Array

_ITERATIONS = 30
_CONVERGED = 1e-12
_LARGEST_RESIDUAL = 1e-9
"""Of a ray that is found, on the normalised image plane; a thousandth of a thousandth of a pixel."""
_STEEPEST = 0.5 * np.pi - 1e-3
"""Angle off the axis up to which a ray meets the normalised image plane [rad]."""


class Lens(Enum):
    """How a lens distorts."""

    NONE = "none"
    RADTAN = "radtan"
    """Coefficients (k1, k2, p1, p2) or (k1, k2, p1, p2, k3)."""
    KANNALA_BRANDT = "kannala_brandt"
    """Coefficients (k1, k2, k3, k4)."""

    @property
    def counts(self) -> tuple[int, ...]:
        """How many coefficients it may have."""
        return {Lens.NONE: (0,), Lens.RADTAN: (4, 5), Lens.KANNALA_BRANDT: (4,)}[self]


@dataclass(frozen=True)
class Camera:
    """Intrinsics and lens of one camera.

    Attributes
    ----------
    width, height : int
        Of its images [px].
    fx, fy, cx, cy : float
        Focal lengths and principal point [px].
    lens : Lens
    coefficients : tuple of float
        As many as the lens has.

    Raises
    ------
    ValueError
        If there are not as many coefficients as the lens has.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    lens: Lens = Lens.NONE
    coefficients: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Reject a wrong number of coefficients."""
        if len(self.coefficients) not in self.lens.counts:
            wanted = " or ".join(map(str, self.lens.counts))
            raise ValueError(
                f"coefficients of {self.lens.value} must be {wanted} numbers, got {len(self.coefficients)}"
            )

    def distort(self, normalised: Array) -> Array:
        """Pixels ``(n, 2)`` of points ``(n, 2)`` on the normalised image plane (z = 1)."""
        point = normalised
        if self.lens is Lens.RADTAN:
            point, _ = _radtan(normalised, self.coefficients)
        elif self.lens is Lens.KANNALA_BRANDT:
            point = _kannala_brandt(normalised, self.coefficients)
        return point * [self.fx, self.fy] + [self.cx, self.cy]

    def undistort(self, pixels: Array) -> Array:
        """Points ``(n, 2)`` on the normalised image plane that :meth:`distort` takes to pixels ``(n, 2)``.

        NaN where there is none: the lens model folds, or the ray is at a right angle to the axis or beyond.
        """
        point = (pixels - [self.cx, self.cy]) / [self.fx, self.fy]
        if self.lens is Lens.RADTAN:
            return _inverse_radtan(point, self.coefficients)
        if self.lens is Lens.KANNALA_BRANDT:
            return _inverse_kannala_brandt(point, self.coefficients)
        return point


def _radtan(point: Array, coefficients: tuple[float, ...]) -> tuple[Array, Array]:
    """Distorted points ``(n, 2)`` and their derivative ``(n, 2, 2)``."""
    k1, k2, p1, p2, k3 = (*coefficients, 0.0)[:5]
    x, y = point.T
    square = x * x + y * y
    radial = 1.0 + square * (k1 + square * (k2 + square * k3))
    slope = 2.0 * (k1 + square * (2.0 * k2 + square * 3.0 * k3))
    out = np.column_stack(
        [
            x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
            y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
    )
    jacobian = np.empty((len(point), 2, 2))
    jacobian[:, 0, 0] = radial + x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    jacobian[:, 1, 1] = radial + y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    jacobian[:, 0, 1] = jacobian[:, 1, 0] = x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    return out, jacobian


def _inverse_radtan(wanted: Array, coefficients: tuple[float, ...]) -> Array:
    """Newton's iteration from the distorted point, which lies on the near side of the fold of the lens."""
    point = wanted.copy()
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        for _ in range(_ITERATIONS):
            reached, jacobian = _radtan(point, coefficients)
            step = _solve(jacobian, wanted - reached)
            point += step
            if not np.nanmax(np.abs(step), initial=0.0) > _CONVERGED:
                break
        reached, jacobian = _radtan(point, coefficients)
        off = np.abs(wanted - reached).max(axis=1, initial=0.0)
        # Beyond the fold the derivative turns the image inside out: a solution there is no ray.
        proper = (_determinant(jacobian) > 0.0) & (np.trace(jacobian, axis1=1, axis2=2) > 0.0)
    return np.where(((off < _LARGEST_RESIDUAL) & proper)[:, None], point, np.nan)


def _determinant(matrix: Array) -> Array:
    return np.asarray(matrix[:, 0, 0] * matrix[:, 1, 1] - matrix[:, 0, 1] * matrix[:, 1, 0])


def _solve(matrix: Array, right: Array) -> Array:
    """Solution ``(n, 2)`` of ``(n, 2, 2)`` systems by Cramer's rule; not finite if singular."""
    x = matrix[:, 1, 1] * right[:, 0] - matrix[:, 0, 1] * right[:, 1]
    y = matrix[:, 0, 0] * right[:, 1] - matrix[:, 1, 0] * right[:, 0]
    return np.column_stack([x, y]) / _determinant(matrix)[:, None]


def _polynomial(angle: Array, coefficients: tuple[float, ...]) -> tuple[Array, Array]:
    """Radius of an angle off the axis by Kannala and Brandt, and its derivative, ``(n,)`` each."""
    square = angle * angle
    radius, slope = np.zeros_like(angle), np.zeros_like(angle)
    for power, k in reversed(list(enumerate((1.0, *coefficients)))):
        radius = radius * square + k
        slope = slope * square + (2 * power + 1) * k
    return radius * angle, slope


def _kannala_brandt(point: Array, coefficients: tuple[float, ...]) -> Array:
    radius = np.linalg.norm(point, axis=1)
    bent, _ = _polynomial(np.arctan(radius), coefficients)
    return point * _ratio(bent, radius)[:, None]


def _inverse_kannala_brandt(wanted: Array, coefficients: tuple[float, ...]) -> Array:
    radius = np.linalg.norm(wanted, axis=1)
    angle = np.minimum(radius, _STEEPEST)
    for _ in range(_ITERATIONS):
        reached, slope = _polynomial(angle, coefficients)
        step = (radius - reached) / np.where(slope > 0.0, slope, np.inf)
        angle = np.clip(angle + step, 0.0, _STEEPEST)
        if not np.abs(step).max(initial=0.0) > _CONVERGED:
            break
    reached, slope = _polynomial(angle, coefficients)
    proper = (np.abs(radius - reached) < _LARGEST_RESIDUAL) & (slope > 0.0) & (angle < _STEEPEST)
    return np.where(proper[:, None], wanted * _ratio(np.tan(angle), radius)[:, None], np.nan)


def _ratio(above: Array, below: Array) -> Array:
    """Quotient that is 1 on the axis, where both are 0."""
    return np.where(below > 0.0, above / np.where(below > 0.0, below, 1.0), 1.0)
