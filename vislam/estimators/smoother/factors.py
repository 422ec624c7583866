"""The factors of the tracks: GTSAM's own, with the noise and the kernel that are asked for."""

from collections.abc import Iterable
from typing import Any

import gtsam
import gtsam_unstable
import numpy as np

from vislam.base.types import Array
from vislam.estimators.smoother.keys import X
from vislam.estimators.smoother.pixel_errors import PixelErrors
from vislam.estimators.smoother.tracks import View
from vislam.models import CameraErrors, Kernel, StereoRig

_VAGUE = 1e3
"""Standard deviation of a landmark of which nothing is known [m]."""
_MOST_NOISES = 1000


class StereoFactors:
    """Factors of what a stereo rig sees.

    Parameters
    ----------
    rig : StereoRig
    pixels : PixelErrors or None
        Shared errors of the pixels that are variables; observations have two factors each then, and no
        kernel.
    kernel : Kernel or None
        Student's density of the pixel errors, as GTSAM's Cauchy kernel, which is the same function; smart
        factors have none.

    Attributes
    ----------
    kernel : Kernel or None
    """

    def __init__(
        self, rig: StereoRig, *, pixels: PixelErrors | None = None, kernel: Kernel | None = None
    ) -> None:
        self._pixels = pixels
        self._calibration = gtsam.Cal3_S2Stereo(rig.fx, rig.fy, 0.0, rig.cx, rig.cy, rig.baseline)
        self._body_P_sensor = gtsam.Pose3(rig.imu_T_cam)
        self.kernel = kernel
        self._kernel, self._narrower = None, 1.0
        if kernel is not None:
            threshold, self._narrower = kernel.cauchy
            self._kernel = gtsam.noiseModel.mEstimator.Cauchy.Create(threshold)
        self._noises: dict[tuple[float, ...], gtsam.noiseModel.Base] = {}

    @property
    def errors(self) -> CameraErrors:
        """Shared errors of the pixels as known now."""
        return CameraErrors() if self._pixels is None else self._pixels.errors

    @property
    def repeated(self) -> int:
        """Rows of an observation that its factors have once more than it has numbers."""
        return 0 if self._pixels is None else 1

    def stereo(self, k: int, key: int, *, z: Array, sigma: Array) -> list[gtsam.NonlinearFactor]:
        """Factors of a landmark seen from frame k as ``z (3,)`` = (uL, uR, v), ``sigma (3,)`` [px]."""
        if self._pixels is not None:
            return self._pixels.stereo(k, key, z=z, sigma=sigma)
        point, noise = gtsam.StereoPoint2(*z), self._noise(sigma)
        return [gtsam.GenericStereoFactor3D(point, noise, X(k), key, self._calibration, self._body_P_sensor)]

    def smart(self, views: Iterable[View]) -> gtsam.NonlinearFactor:
        """One factor of all views of a track, in which the landmark is eliminated at each linearisation."""
        views = list(views)
        noise = gtsam.noiseModel.Isotropic.Sigma(3, float(np.mean([view.sigma[0] for view in views])))
        factor = gtsam_unstable.SmartStereoProjectionPoseFactor(
            noise, gtsam.SmartProjectionParams(), self._body_P_sensor
        )
        for view in views:
            factor.add(gtsam.StereoPoint2(*view.z), X(view.k), self._calibration)
        return factor

    def vague(self, key: int, point: Array) -> gtsam.NonlinearFactor:
        """Prior of a landmark that tells next to nothing, but where it is if nobody else does."""
        return gtsam.PriorFactorPoint3(key, point, _sigmas(np.full(3, _VAGUE)))

    def _noise(self, sigma: Array) -> gtsam.noiseModel.Base:
        """Noise of a stereo factor; the same object for the same numbers."""
        which = tuple(sigma.tolist())
        if len(self._noises) > _MOST_NOISES:
            self._noises.clear()
        if which not in self._noises:
            noise: gtsam.noiseModel.Base = _sigmas(self._narrower * sigma)
            if self._kernel is not None:
                noise = gtsam.noiseModel.Robust.Create(self._kernel, noise)
            self._noises[which] = noise
        return self._noises[which]


def _sigmas(sigma: Any) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigma, float))
