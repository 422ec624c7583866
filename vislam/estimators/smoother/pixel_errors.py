"""Shared errors of the pixels as variables of the graph: disparity offset, principal point, focal scale.

GTSAM's stereo factor has a fixed calibration. Where one of these errors is estimated, an observation ``(uL,
uR, v)`` is two monocular factors instead, ``(uL, v)`` with the calibration ``F`` of the left camera and
``(uR, v)`` with that of the right one, ``G``, each with twice the variance of the row: their sum is the same
function. Both are GTSAM's own, with pose, mounting, landmark and calibration as variables; the mountings are
pinned.

The calibrations (fx, fy, skew, u0, v0) are tied to the errors o, p and s, linearly, so exactly:

    F = K + (s fx, s fy, 0, p_u, p_v),    G = F - (0, 0, 0, o, 0),

by their priors and, where they walk, by their walks from frame to frame. What no error moves is pinned: to
1e-4 px and 1e-6 rad, since GTSAM's Cholesky refuses pivots that are small beside the last one, or, for QR, a
tenth and a hundredth of that, where nothing is left of it in nine digits of a covariance.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import gtsam
import gtsam_unstable
import numpy as np

from vislam.base.types import Array
from vislam.core.frame import Frame
from vislam.estimators.smoother.keys import E, F, G, X
from vislam.estimators.smoother.linear import linear_factor
from vislam.models import CameraErrors, SharedPrior, StereoRig
from vislam.models.shared_errors import DISPARITY_OFFSET, FOCAL_SCALE, OF_PIXELS, PRINCIPAL_POINT

_PIN = {"cholesky": (1e-4, 1e-6), "qr": (1e-5, 1e-8)}
"""What is pinned may be off by this: calibrations [px], mountings [rad, m]; by the factorisation."""
_LEFT, _RIGHT = E(0), E(1)
_IDENTITY = np.eye(5)


class KnownCamera:
    """A model of motion that has no variable for an error of the cameras."""

    @property
    def pixels(self) -> "PixelErrors | None":
        """None: the calibration is assumed known."""
        return None

    def rotation(self, k: int) -> int | None:
        """None: the mounting is assumed known."""
        del k
        return None


class PixelErrors:
    """Calibrations of both cameras as variables.

    Parameters
    ----------
    rig : StereoRig
        As stated.
    priors : mapping of str to SharedPrior
        Those of the shared errors that are not known.
    factorization : str
        ``qr`` where nothing else is asked.

    Attributes
    ----------
    walks : bool
        Whether any of them walks, so that each frame has calibrations of its own.
    errors : CameraErrors
        As read last.
    """

    def __init__(self, rig: StereoRig, priors: Mapping[str, SharedPrior], *, factorization: str) -> None:
        self._rig = rig
        self._pin, self._pin_mounting = _PIN["qr" if factorization == "qr" else "cholesky"]
        self._priors = {name: priors[name] for name in OF_PIXELS if name in priors}
        self.walks = any(prior.walk > 0.0 for prior in self._priors.values())
        self.errors = CameraErrors()
        # Rows: focal scale, its equality, skew, column and row of the principal point [px].
        self._rows = _IDENTITY.copy()
        self._rows[1, :2] = 1.0, -rig.fx / rig.fy

    @property
    def names(self) -> Sequence[str]:
        """Errors that are in use."""
        return tuple(self._priors)

    def left(self, k: int) -> int:
        """Key of the left calibration at a frame."""
        return F(k if self.walks else 0)

    def right(self, k: int) -> int:
        """Key of the right one: the same where no disparity offset tells them apart."""
        return G(k if self.walks else 0) if DISPARITY_OFFSET in self._priors else self.left(k)

    def keys(self, k: int) -> list[int]:
        """Keys of the calibrations at a frame."""
        return list(dict.fromkeys([self.left(k), self.right(k)]))

    def mountings(self) -> list[int]:
        """Keys of the mountings, which all frames have in common."""
        return [_LEFT, _RIGHT]

    def new(self, k: int) -> bool:
        """Whether a frame has calibrations of its own."""
        return k == 0 or self.walks

    def insert(self, values: gtsam.Values, k: int) -> None:
        """Insert the variables that are new at a frame, as known so far."""
        if k == 0:
            values.insert(_LEFT, gtsam.Pose3(self._rig.imu_T_cam))
            values.insert(_RIGHT, gtsam.Pose3(_right(self._rig)))
        if self.new(k):
            errors, rig = self.errors, self.errors.rig(self._rig)
            values.insert(self.left(k), gtsam.Cal3_S2(rig.fx, rig.fy, 0.0, rig.cx, rig.cy))
            if DISPARITY_OFFSET in self._priors:
                right = rig.cx - errors.disparity_offset
                values.insert(self.right(k), gtsam.Cal3_S2(rig.fx, rig.fy, 0.0, right, rig.cy))

    def factors(self, frame: Frame) -> list[gtsam.NonlinearFactor]:
        """Priors at the first frame, and walks to the others."""
        k = frame.k
        if k > 0:
            return self._walk(frame) if self.walks else []
        pinned = _sigmas(np.full(6, self._pin_mounting))
        sigma = {name: prior.sigma for name, prior in self._priors.items()}
        return [
            gtsam.PriorFactorPose3(_LEFT, gtsam.Pose3(self._rig.imu_T_cam), pinned),
            gtsam.PriorFactorPose3(_RIGHT, gtsam.Pose3(_right(self._rig)), pinned),
            self._linear({self.left(0): self._rows}, self._spread(sigma)),
            *self._apart({self.right(0): _IDENTITY, self.left(0): -_IDENTITY}, sigma),
        ]

    def stereo(self, k: int, key: int, *, z: Array, sigma: Array) -> list[gtsam.NonlinearFactor]:
        """Both factors of a landmark seen from frame k as ``z (3,)`` = (uL, uR, v), ``sigma (3,)`` [px]."""
        factor = gtsam_unstable.ProjectionFactorPPPCCal3_S2
        row = np.sqrt(2.0) * sigma[2]
        return [
            factor(z[[0, 2]], _sigmas([sigma[0], row]), X(k), _LEFT, key, self.left(k)),
            factor(z[[1, 2]], _sigmas([sigma[1], row]), X(k), _RIGHT, key, self.right(k)),
        ]

    def values(self, left: gtsam.Cal3_S2, right: gtsam.Cal3_S2) -> dict[str, Array]:
        """Errors ``(m,)`` of two calibrations, by name."""
        rig = self._rig
        every = {
            DISPARITY_OFFSET: [left.px() - right.px()],
            PRINCIPAL_POINT: [left.px() - rig.cx, left.py() - rig.cy],
            FOCAL_SCALE: [left.fx() / rig.fx - 1.0],
        }
        return {name: np.array(every[name]) for name in self._priors}

    def sigmas(self, cov: Array) -> dict[str, Array]:
        """Standard deviations of the errors, by name, from the covariance ``(5, 5)`` or ``(10, 10)``."""
        apart = cov[3, 3] + cov[-2, -2] - 2.0 * cov[3, -2]
        every = {
            DISPARITY_OFFSET: np.array([max(apart, 0.0)]),
            PRINCIPAL_POINT: np.diagonal(cov)[3:5],
            FOCAL_SCALE: np.array([cov[0, 0] / self._rig.fx**2]),
        }
        return {name: np.sqrt(every[name]) for name in self._priors}

    def _walk(self, frame: Frame) -> list[gtsam.NonlinearFactor]:
        k, sigma = frame.k, {name: np.sqrt(frame.dt) * prior.walk for name, prior in self._priors.items()}
        along = {self.left(k): self._rows, self.left(k - 1): -self._rows}
        # Both right calibrations stay with the left ones but for the column, whose distance walks.
        column = np.diag([0.0, 0.0, 0.0, 1.0, 0.0])
        apart = {
            self.right(k): _IDENTITY,
            self.left(k): -_IDENTITY,
            self.right(k - 1): -column,
            self.left(k - 1): column,
        }
        return [self._linear(along, self._spread(sigma)), *self._apart(apart, sigma)]

    def _spread(self, sigma: Mapping[str, float]) -> Array:
        """Standard deviations ``(5,)`` of the rows of a left calibration, pinned where nothing moves it."""
        scale, point = self._rig.fx * sigma.get(FOCAL_SCALE, 0.0), sigma.get(PRINCIPAL_POINT, 0.0)
        return np.maximum([scale, 0.0, 0.0, point, point], self._pin)

    def _apart(self, terms: dict[int, Array], sigma: Mapping[str, float]) -> list[gtsam.NonlinearFactor]:
        """What tells the right calibration from the left one, if anything does."""
        if DISPARITY_OFFSET not in self._priors:
            return []
        spread = np.maximum([0.0, 0.0, 0.0, sigma[DISPARITY_OFFSET], 0.0], self._pin)
        return [self._linear(terms, spread)]

    def _linear(self, terms: Mapping[int, Array], sigma: Array) -> gtsam.NonlinearFactor:
        """Linear factor of calibrations less the stated one: ``sum_i A_i (K_i - K) = 0`` within ``sigma``."""
        rig, at = self._rig, gtsam.Values()
        for key in terms:
            at.insert(key, gtsam.Cal3_S2(rig.fx, rig.fy, 0.0, rig.cx, rig.cy))
        return linear_factor(terms, np.zeros(5), sigma, at=at)


def _right(rig: StereoRig) -> Array:
    """Pose ``(4, 4)`` of the right camera in the body."""
    shift = np.eye(4)
    shift[0, 3] = rig.baseline
    return np.asarray(rig.imu_T_cam @ shift)


def _sigmas(sigma: Any) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigma, float))
