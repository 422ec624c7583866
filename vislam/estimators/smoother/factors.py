"""The one builder of factors: every smoother poses the same problem, and it is the filter's.

All factors are GTSAM's own. A factor written in Python is handed a copy of all values each time it is
linearised, so that a step would take the longer the longer the drive already is.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import gtsam
import gtsam_unstable
import numpy as np

from vislam.base.types import Array
from vislam.core.estimator import HEIGHT_SIGMA, UNKNOWN_CLIMB, Problem
from vislam.core.sequence import Frame
from vislam.estimators.smoother.keys import CLOCK, H, V, W, X
from vislam.estimators.smoother.tracks import View

_UNUSED = 1.0
"""Spread of the two coordinates of a height's point that no factor asks for [m]."""
_SMALLEST_DENSITY = 1e-9
_VAGUE = 1e3
"""Standard deviation of a landmark of which nothing is known [m]."""
_MOST_NOISES = 1000

_KERNELS: Mapping[str, tuple[Any, float]] = {
    # Each with the threshold on the norm of a whitened residual of three numbers at which an estimate of
    # location is 95 % efficient under Gaussian noise; DCS has that of Geman-McClure, which it resembles.
    "huber": (gtsam.noiseModel.mEstimator.Huber, 1.628),
    "cauchy": (gtsam.noiseModel.mEstimator.Cauchy, 2.666),
    "tukey": (gtsam.noiseModel.mEstimator.Tukey, 5.490),
    "welsch": (gtsam.noiseModel.mEstimator.Welsch, 3.469),
    "geman_mcclure": (gtsam.noiseModel.mEstimator.GemanMcClure, 4.337),
    "dcs": (gtsam.noiseModel.mEstimator.DCS, 4.337),
}


class FactorBuilder:
    """Factors of a :class:`Problem`, in the project's tangent order, which is GTSAM's.

    The motion over a step is ``log(T_{k-1}^-1 T_k) = dt w_k + n`` with w the inertial twist less its bias and
    n of covariance ``dt diag(density^2)``: :func:`vislam.models.odometry.integrate` with the noise told on
    the twist. GTSAM has it as a part of its white-noise-on-acceleration prior (Anderson and Barfoot, IROS
    2015), between a pose and a twist before and after. Its twist after the step is here a variable of its
    own, ``V(k)``, in no other factor: it takes up the other half of the error whatever that is, and of the
    first half, whose covariance is ``dt^3 / 3 Qc``, nothing is lost.

    As w is the variable and not the bias, the walk of the bias is ``w_{k+1} - w_k = u_{k+1} - u_k + n``.

    With the climb rate in use, the world's z axis is up and the first pose is free to be tilted; else the
    first pose is the identity.

    Parameters
    ----------
    problem : Problem
    robust : str
        Kernel of the stereo factors, ``none`` for none.
    threshold : float or None
        Its threshold in standard deviations; None for the usual one.
    """

    def __init__(self, problem: Problem, *, robust: str = "none", threshold: float | None = None) -> None:
        rig = problem.rig
        self._problem = problem
        self._calibration = gtsam.Cal3_S2Stereo(rig.fx, rig.fy, 0.0, rig.cx, rig.cy, rig.baseline)
        self._body_P_sensor = gtsam.Pose3(rig.imu_T_cam)
        self._kernel = None
        if robust != "none":
            kernel, usual = _KERNELS[robust]
            self._kernel = kernel.Create(usual if threshold is None else threshold)
        self._noises: dict[tuple[float, ...], gtsam.noiseModel.Base] = {}
        self._estimate_clock = problem.clock_sigma > 0.0
        """Whether the clock is a variable."""

    def step(self, frame: Frame, before: Frame | None) -> list[gtsam.NonlinearFactor]:
        """All factors of a frame but the stereo ones: priors, motion, walk of the bias, climb."""
        k, problem = frame.k, self._problem
        if before is None:
            factors: list[gtsam.NonlinearFactor] = [
                gtsam.PriorFactorPose3(X(0), gtsam.Pose3(), _sigmas(self._first_pose_sigma()))
            ]
            if problem.climb is not None:
                factors.append(gtsam.PriorFactorPoint3(H(0), np.zeros(3), _sigmas([_UNUSED, _UNUSED, 1e-4])))
        else:
            end = gtsam.StateData(X(k), V(k), frame.dt)
            density = np.maximum(problem.noise.twist, _SMALLEST_DENSITY)
            factors = [
                gtsam.WnoaMotionFactorPose3(
                    gtsam.StateData(X(k - 1), W(k), 0.0), end, 3.0 * (density / frame.dt) ** 2
                ),
                *self._twist(frame, before),
            ]
            if problem.climb is not None:
                known = np.isfinite(frame.climb_rate)
                spread = np.sqrt(frame.dt) * problem.climb.walk if known else frame.dt * UNKNOWN_CLIMB
                rise = np.array([0.0, 0.0, frame.dt * frame.climb_rate if known else 0.0])
                factors.append(
                    gtsam.BetweenFactorPoint3(H(k - 1), H(k), rise, _sigmas([_UNUSED, _UNUSED, spread]))
                )
        if problem.climb is not None:
            factors.append(gtsam_unstable.RelativeElevationFactor(X(k), H(k), 0.0, _sigmas([HEIGHT_SIGMA])))
        return factors

    def stereo(self, k: int, key: int, *, z: Array, sigma: Array) -> gtsam.NonlinearFactor:
        """Stereo factor of a landmark seen from frame k as ``z (3,)`` = (uL, uR, v), ``sigma (3,)`` [px]."""
        return gtsam.GenericStereoFactor3D(
            gtsam.StereoPoint2(*z), self._noise(sigma), X(k), key, self._calibration, self._body_P_sensor
        )

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

    def insert(self, values: gtsam.Values, frame: Frame, *, pose: Array, twist: Array, height: float) -> None:
        """Give the variables of a frame their first values; ``twist (6,)`` is that less its bias."""
        k = frame.k
        values.insert(X(k), gtsam.Pose3(pose))
        if k > 0:
            values.insert(W(k), twist)
            values.insert(V(k), twist)
        if k == 1 and self._estimate_clock:
            values.insert(CLOCK, np.zeros(1))
        if self._problem.climb is not None:
            values.insert(H(k), np.array([0.0, 0.0, height]))

    def keys(self, k: int) -> list[int]:
        """Keys of a frame's own variables."""
        return [
            X(k),
            *([W(k), V(k)] if k > 0 else []),
            *([H(k)] if self._problem.climb is not None else []),
        ]

    def tied(self, k: int) -> list[int]:
        """Keys that the factors of the next frame tie to."""
        clock = [CLOCK] if k > 0 and self._estimate_clock else []
        return [*(key for key in self.keys(k) if key != V(k)), *clock]

    def newest(self, k: int) -> list[int]:
        """Keys of a frame's own variables and of those that the factors of the next frame tie to."""
        return list(dict.fromkeys([*self.keys(k), *self.tied(k)]))

    def _first_pose_sigma(self) -> Array:
        sigma = np.array(self._problem.first_pose_sigma)
        if self._problem.climb is not None:
            sigma[:2] = np.hypot(sigma[:2], self._problem.climb.tilt_sigma)
        return sigma

    def _twist(self, frame: Frame, before: Frame) -> list[gtsam.NonlinearFactor]:
        """Ties of the twist less its bias: the prior of the bias at the first step, its walk after that."""
        problem, key = self._problem, W(frame.k)
        late = frame.twist_change / frame.dt
        if before.k == 0:
            mean, sigma = frame.twist - problem.bias_mean, np.asarray(problem.bias_sigma)
            if not self._estimate_clock:
                return [gtsam.PriorFactorVector(key, mean, _sigmas(sigma))]
            clock = gtsam.PriorFactorVector(CLOCK, np.zeros(1), _sigmas([problem.clock_sigma]))
            return [clock, _linear({key: np.eye(6), CLOCK: -late[:, None]}, mean, sigma)]
        change = frame.twist - before.twist
        sigma = np.sqrt(before.dt) * problem.noise.bias_walk
        if not self._estimate_clock:
            return [gtsam.BetweenFactorVector(W(before.k), key, change, _sigmas(sigma))]
        by_clock = before.twist_change / before.dt - late
        return [_linear({W(before.k): -np.eye(6), key: np.eye(6), CLOCK: by_clock[:, None]}, change, sigma)]

    def _noise(self, sigma: Array) -> gtsam.noiseModel.Base:
        """Noise of a stereo factor; the same object for the same numbers."""
        which = tuple(sigma.tolist())
        if len(self._noises) > _MOST_NOISES:
            self._noises.clear()
        if which not in self._noises:
            noise: gtsam.noiseModel.Base = _sigmas(sigma)
            if self._kernel is not None:
                noise = gtsam.noiseModel.Robust.Create(self._kernel, noise)
            self._noises[which] = noise
        return self._noises[which]


def _sigmas(sigma: Any) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Diagonal.Sigmas(np.asarray(sigma, float))


def _linear(terms: Mapping[int, Array], right: Array, sigma: Array) -> gtsam.NonlinearFactor:
    """Linear factor of vector variables: ``sum_i A_i x_i = right`` within ``sigma (m,)``."""
    values = gtsam.Values()
    for key, matrix in terms.items():
        values.insert(key, np.zeros(matrix.shape[1]))
    blocks = [part for term in terms.items() for part in term]
    linear: Any = gtsam.JacobianFactor
    return gtsam.LinearContainerFactor(linear(*blocks, right, _sigmas(sigma)), values)
