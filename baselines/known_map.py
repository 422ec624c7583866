"""Localisation on a given map (course report, section III-C): the pose alone by EKF."""

from collections.abc import Mapping
from dataclasses import dataclass as plain_dataclass
from typing import Any

import numpy as np
from pydantic.dataclasses import dataclass
from scipy.stats import chi2

from vislam.base import settings
from vislam.base.fields import STRICT, Positive
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.estimator import Problem
from vislam.core.frame import Frame
from vislam.core.step import TWIST_BIAS, Final, State, Step
from vislam.geometry import se3
from vislam.models import odometry as motion
from vislam.models.odometry import BIAS, NAV, POSE, MotionNoise
from vislam_baselines.observations import NEAREST, Observations, look, pixel_variances
from vislam_baselines.saved import SavedRun
from vislam_baselines.twist import require_twist

_OTHER_MAP_PX = 20.0
"""A map half of whose points are farther from the pixels, seen from its own pose, is of other tracks."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class KnownMapOptions:
    """Options of localisation on a given map."""

    map: str
    """File of a saved run of the same data with the same repairs, whose landmarks are the map."""
    map_uncertainty: bool = True
    """Take the map's covariances, where it has them, for noise of the pixels; false: the map is exact."""
    pixel_variance: Positive | None = 5.0
    """Variance of each pixel coordinate, the report's V [px^2]; null: the noise of the comparison."""
    bias: bool = False
    """Estimate the twist bias; false: it is its prior mean, as in the report, which has none."""
    gate: bool = True
    """Reject observations by a chi-square test of their innovation."""


def build(problem: Problem, options: Mapping[str, Any]) -> "KnownMap":
    """Build the localisation from a problem and the options of its config section."""
    require_twist(problem, "estimators.known_map")
    return KnownMap(problem, settings.parse(KnownMapOptions, dict(options), at="estimators.known_map"))


class KnownMap:
    """EKF of the pose with a known map (Barfoot 2017, section 4.2.3).

    The course report's eqs. 14 and 23 to 26, with the sign and the inverse that eq. 26 lacks.

    A landmark is as wrong in one frame as in the next. Its covariance is taken for noise that is new in every
    frame, so the pose is surer of itself than the map can make it.
    """

    def __init__(self, problem: Problem, options: KnownMapOptions) -> None:
        self._problem = problem
        self._options = options
        self._saved = SavedRun(options.map, at="estimators.known_map.map")
        self._fits = False
        self._threshold = float(chi2.ppf(problem.gate_probability, 3)) if options.gate else np.inf
        self._noise = problem.noise
        sigma = np.concatenate([problem.first_pose_sigma, problem.bias_sigma])
        if not options.bias:
            # A bias that is known has no variance and gains none, so that nothing moves it.
            sigma[BIAS] = 0.0
            self._noise = MotionNoise(problem.noise.twist, np.zeros(6))
        self._world_T_imu, self._bias, self._cov = np.eye(4), problem.bias_mean, np.diag(sigma**2)

    def process(self, frame: Frame) -> Step:
        """Take one frame: predict, gate, update."""
        if frame.k > 0:
            self._predict(frame)
        rows, slots = self._in_map(frame)
        innovation = self._innovation(frame, rows, slots)
        passes = (innovation.depth > NEAREST) & (innovation.distances(self._cov) <= self._threshold)
        allowed = frame.stereo.usable[rows]
        nis, log_likelihood = self._update(innovation.select(allowed & passes))
        used, gated = np.zeros((2, len(frame.stereo)), bool)
        used[rows[allowed & passes]], gated[rows[allowed & ~passes]] = True, True
        sigma = np.sqrt(np.diagonal(self._cov)[BIAS]) if self._options.bias else None
        return Step(
            pose=self._world_T_imu,
            pose_cov=self._cov[POSE, POSE].copy(),
            states={TWIST_BIAS: State(self._bias, sigma)},
            nis=nis,
            dof=3 * int(np.count_nonzero(used)),
            log_likelihood=log_likelihood,
            used=used,
            gated=gated,
        )

    def finalize(self) -> Final:
        """Leave the poses as they were; the map was given. ConfigError if it has no track of the data."""
        if not self._fits:
            raise self._saved.refusal("has none of the tracks")
        return Final(up=self._saved.run.up)

    def _in_map(self, frame: Frame) -> tuple[IntArray, IntArray]:
        """Rows of the frame whose tracks are in the map, and their places there.

        Ids of tracks mean something in one recording with one set of repairs only, and every map has small
        ones. That it is of this data shows, once, in how it looks from its own pose.
        """
        points = self._saved.run.landmarks
        _, rows, slots = np.intersect1d(
            frame.stereo.track, points.track, assume_unique=True, return_indices=True
        )
        if len(rows) and not self._fits:
            seen = look(self._problem.rig, self._saved.pose(frame), points.points_world[slots])
            if np.median(np.abs(frame.stereo.z[rows] - seen.z).max(axis=1)) > _OTHER_MAP_PX:
                raise self._saved.refusal(f"is not where frame {frame.k} sees its tracks")
            self._fits = True
        return rows, slots

    def _predict(self, frame: Frame) -> None:
        step = motion.integrate(frame.odometry.twist, bias=self._bias, dt=frame.dt, noise=self._noise)
        transition, noise = motion.transition(step)
        self._world_T_imu = self._world_T_imu @ step.prev_T_next
        self._cov = transition @ self._cov @ transition.T + noise

    def _innovation(self, frame: Frame, rows: IntArray, slots: IntArray) -> "_Innovation":
        points = self._saved.run.landmarks
        seen = look(self._problem.rig, self._world_T_imu, points.points_world[slots])
        variance = pixel_variances(frame, self._options.pixel_variance)[rows]
        noise = variance[:, :, None] * np.eye(3)
        if self._options.map_uncertainty and points.points_cov is not None:
            noise = noise + seen.by_point @ points.points_cov[slots] @ seen.by_point.transpose(0, 2, 1)
        return _Innovation.of(seen, frame.stereo.z[rows], noise)

    def _update(self, innovation: "_Innovation") -> tuple[float, float]:
        """Correct pose and bias; the NIS and the logarithm of the density of the innovation."""
        value, jacobian = innovation.value.reshape(-1), innovation.jacobian.reshape(-1, NAV)
        projected = jacobian @ self._cov
        spread = projected @ jacobian.T + np.eye(len(value))
        gain = np.linalg.solve(spread, projected).T
        correction = gain @ value
        kept = np.eye(NAV) - gain @ jacobian
        self._cov = kept @ self._cov @ kept.T + gain @ gain.T
        self._world_T_imu = se3.retract(self._world_T_imu, correction[POSE])
        self._bias = self._bias + correction[BIAS]
        nis = float(value @ np.linalg.solve(spread, value))
        log_det = float(np.linalg.slogdet(spread)[1]) + 2.0 * float(np.log(innovation.unit).sum())
        return nis, -0.5 * (nis + log_det + len(value) * float(np.log(2.0 * np.pi)))


@plain_dataclass(frozen=True)
class _Innovation:
    """Measured less predicted, in units of its noise, of each track by itself.

    Attributes
    ----------
    depth : (n,)
        Predicted [m].
    value : (n, 3)
    jacobian : (n, 3, NAV)
    unit : (n, 3)
        Diagonal of the Cholesky factor of the noise [px].
    """

    depth: Array
    value: Array
    jacobian: Array
    unit: Array

    @classmethod
    def of(cls, seen: Observations, z: Array, noise: Array) -> "_Innovation":
        """Innovation of measurements ``(n, 3)`` [px] with noise ``(n, 3, 3)`` [px^2]."""
        root = np.linalg.cholesky(noise)
        jacobian = np.zeros((len(z), 3, NAV))
        jacobian[:, :, POSE] = np.linalg.solve(root, seen.by_pose)
        value = np.linalg.solve(root, (z - seen.z)[:, :, None])[:, :, 0]
        return cls(seen.depth, value, jacobian, np.diagonal(root, axis1=1, axis2=2))

    def select(self, which: BoolArray) -> "_Innovation":
        """Those of a mask."""
        return _Innovation(self.depth[which], self.value[which], self.jacobian[which], self.unit[which])

    def distances(self, cov: Array) -> Array:
        """Squared Mahalanobis distance ``(n,)`` of each, the state's covariance being ``(NAV, NAV)``."""
        spread = self.jacobian @ cov @ self.jacobian.transpose(0, 2, 1) + np.eye(3)
        return np.einsum("ni,ni->n", self.value, np.linalg.solve(spread, self.value[:, :, None])[:, :, 0])
