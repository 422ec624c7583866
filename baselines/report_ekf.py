"""The course report's visual-inertial SLAM (section III-D), each trait that made it fail an option.

One dense filter of the pose and all landmarks so far, the EKF of Barfoot, *State Estimation for Robotics*
(2017), section 4.2.3, as eqs. (25) to (29) of the report print it; equation numbers are the report's. By
default it is the report's; with all of them mended it is the plain joint EKF (``ekf`` with ``track_errors:
independent``), as tests show. What was wrong with the data rather than with the filter is switched in
``data.repair``.
"""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass
from scipy.stats import chi2

from vislam.base import settings
from vislam.base.fields import STRICT, Positive
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.estimator import Problem
from vislam.core.frame import Frame
from vislam.core.step import TWIST_BIAS, Final, State, Step
from vislam.core.trajectory import Landmarks
from vislam.estimators.former import current
from vislam.geometry import se3, so3
from vislam.models import odometry as motion
from vislam.models.odometry import BIAS, NAV, POSE
from vislam_baselines.landmarks import IndependentLandmarks, initialise
from vislam_baselines.observations import NEAREST, pixel_variances
from vislam_baselines.twist import Integration, require_twist, step_twist

_NO_DEPTH = 1e-2
"""A landmark nearer than this to the plane of the camera, before or behind it, has no observation [m]."""
_ROUNDING = 1e-6
"""Negative eigenvalues of a covariance up to this share of its largest entry are rounding."""

Variances = tuple[Positive, Positive, Positive, Positive, Positive, Positive]


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class ReportEkfOptions:
    """Traits of the filter; each default is the report's."""

    jacobian: Literal["as_printed", "without_sign", "derived"] = "as_printed"
    """Derivative of an observation by the pose. ``as_printed``: eq. (26), without its sign and with the pose
    where its inverse belongs. ``without_sign``: with the inverse. ``derived``: with both."""
    covariance: Literal["as_printed", "joseph"] = "as_printed"
    """``as_printed``: (I - K H) P, which is a covariance for the optimal gain and exact arithmetic only.
    ``joseph``: the form that stays positive (Bucy and Joseph 1968), kept symmetric: what rounding adds of an
    antisymmetric part, no observation takes away again."""
    new_landmarks: Literal["independent", "correlated"] = "independent"
    """``independent``: a new landmark gets ``landmark_variance``, nothing in common with the pose it was seen
    from, and its observation is fused once more. ``correlated``: covariance of pose and observation, used
    once."""
    integration: Integration = "first"
    """Twist of a step: the sample at its beginning, or the mean over it."""
    motion_variance: Variances | None = (0.1, 0.1, 0.1, 1.0, 1.0, 1.0)
    """W of eq. (25), added every step [rad^2, m^2]; null: the comparison's own noise."""
    pixel_variance: Positive | None = 5.0
    """V of eq. (29), of each of the four pixel coordinates [px^2]; null: the comparison's own noise."""
    pose_variance: Positive | None = 1e-3
    """Prior of the first pose [rad^2, m^2]; null: the comparison's own."""
    landmark_variance: Positive = 1e-3
    """Prior of an ``independent`` landmark [m^2]. The report gives none; this is that of its pose."""
    bias: bool = False
    """Whether the bias of the twist is estimated."""
    gate: bool = False
    """Whether observations are rejected by a chi-square test of their innovation, or as behind the camera."""
    pose_gain: Annotated[float, Field(ge=0, le=1)] = 1.0
    """What the correction of the pose is multiplied by; the report's Fig. 5 was made with 0.01."""
    every: Annotated[int, Field(ge=1)] = 20
    """One track in so many is used."""
    ended_tracks: Literal["kept", "marginalised"] = "kept"
    """What becomes of a landmark whose track has ended: it is kept, as in the course report, or marginalised.
    The poses are the same; the time is not: a step costs the cube of the state."""


RENAMED = {"finished": "ended_tracks"}
RENAMED_VALUES = {"ended_tracks": {"dropped": "marginalised"}}
"""Former names of options and of their values, accepted for one version."""


def build(problem: Problem, options: Mapping[str, Any]) -> "ReportEkf":
    """Build the filter from a problem and the options of its config section."""
    at = "estimators.report_ekf"
    require_twist(problem, at)
    renamed = current(options, at=at, names=RENAMED, values=RENAMED_VALUES)
    return ReportEkf(problem, settings.parse(ReportEkfOptions, renamed, at=at))


class ReportEkf:
    """Dense EKF of pose, twist bias and landmarks; the bias stays what it is if it is not estimated.

    Attributes
    ----------
    world_T_imu : (4, 4)
    bias : (6,)
    track : (m,)
        Landmarks in the state.
    points_world : (m, 3)
    cov : (12 + 3m, 12 + 3m)
        Covariance of pose (right perturbation), bias and landmarks.
    """

    def __init__(self, problem: Problem, options: ReportEkfOptions) -> None:
        self._problem, self._options = problem, options
        self._threshold = float(chi2.ppf(problem.gate_probability, 3))
        prior = np.concatenate([problem.first_pose_sigma, problem.bias_sigma]) ** 2
        if options.pose_variance is not None:
            prior[POSE] = options.pose_variance
        if not options.bias:
            prior[BIAS] = 0.0
        self.world_T_imu = np.eye(4)
        self.bias = problem.bias_mean.copy()
        self.track: IntArray = np.empty(0, np.int64)
        self.points_world = np.empty((0, 3))
        self.cov = np.diag(prior)
        self._indefinite: list[int] = []
        self._left: list[IndependentLandmarks] = []

    def process(self, frame: Frame) -> Step:
        """Take one frame."""
        if frame.k > 0:
            self._predict(frame)
        wanted = frame.stereo.usable & (frame.stereo.track % self._options.every == 0)
        if self._options.ended_tracks == "marginalised":
            self._drop(~np.isin(self.track, frame.stereo.track))
        known = np.isin(frame.stereo.track, self.track)
        # A point without a disparity has no place.
        new = wanted & ~known & (frame.stereo.z[:, 0] != frame.stereo.z[:, 1])
        if self._options.new_landmarks == "independent":
            self._append_independent(frame, np.flatnonzero(new))
            used, gated, nis = self._update(frame, wanted & (known | new))
        else:
            used, gated, nis = self._update(frame, wanted & known)
            self._append_correlated(frame, np.flatnonzero(new))
        if not (np.isfinite(self.world_T_imu).all() and np.isfinite(self.cov).all()):
            raise ArithmeticError("pose or covariance is no longer finite")
        # As printed the covariance loses its symmetry; what it claims is the symmetric part.
        claimed = 0.5 * (self.cov[:NAV, :NAV] + self.cov[:NAV, :NAV].T)
        valid = nis >= 0.0 and bool(_semi_definite(claimed))
        self._indefinite += [] if valid else [frame.k]
        sigma = np.sqrt(np.maximum(np.diagonal(claimed)[BIAS], 0.0)) if valid else None
        return Step(
            pose=self.world_T_imu,
            pose_cov=claimed[POSE, POSE] if valid else None,
            states={TWIST_BIAS: State(self.bias.copy(), sigma)},
            nis=nis if valid else 0.0,
            dof=3 * int((used & known).sum()) if valid else 0,
            log_likelihood=float("nan"),
            used=used | new,
            gated=gated,
        )

    def finalize(self) -> Final:
        """Leave the poses as they were, and return the landmarks as they were last known."""
        self._drop(np.ones(len(self.track), bool))
        every = IndependentLandmarks.join(self._left)
        # A track that was out of sight for a while has two; the later one knows more.
        _, last = np.unique(every.track[::-1], return_index=True)
        found = every.select(len(every.track) - 1 - last)
        points_cov = 0.5 * (found.cov + np.swapaxes(found.cov, 1, 2))
        points_cov[~_semi_definite(points_cov)] = np.nan
        return Final(map=Landmarks(found.track, found.points_world, points_cov), events=self._events())

    def _events(self) -> tuple[str, ...]:
        """Say that the covariance ceased to be one."""
        if not self._indefinite:
            return ()
        count, first = len(self._indefinite), self._indefinite[0]
        return (
            f"covariance no longer positive semi-definite at {count} frames, the first is {first}: "
            "they have neither covariance nor NIS",
        )

    def _predict(self, frame: Frame) -> None:
        """Eq. (25), with the bias added."""
        twist = step_twist(frame, self._options.integration)
        step = motion.integrate(twist, bias=self.bias, dt=frame.dt, noise=self._problem.noise)
        transition, noise = motion.transition(step)
        if self._options.motion_variance is not None:
            noise[POSE, POSE] = np.diag(self._options.motion_variance)
        if not self._options.bias:
            noise[BIAS, BIAS] = 0.0
        self.world_T_imu = self.world_T_imu @ step.prev_T_next
        self.cov[:NAV] = transition @ self.cov[:NAV]
        self.cov[:, :NAV] = self.cov[:, :NAV] @ transition.T
        self.cov[:NAV, :NAV] += noise

    def _update(self, frame: Frame, wanted: BoolArray) -> tuple[BoolArray, BoolArray, float]:
        """Eqs. (28) and (29) with the wanted observations; which were fused, which gated, and their NIS."""
        rig = self._problem.rig
        rows = np.flatnonzero(wanted)
        slots = _places(self.track, frame.stereo.track[rows])
        in_camera = se3.transform(se3.inverse(self.world_T_imu @ rig.imu_T_cam), self.points_world[slots])
        seen = np.abs(in_camera[:, 2]) > _NO_DEPTH
        rows, slots, in_camera = rows[seen], slots[seen], in_camera[seen]
        innovation = frame.stereo.z[rows] - rig.project(in_camera)
        by_pose, by_point = self._jacobians(in_camera, self.points_world[slots])
        variance = pixel_variances(frame, self._options.pixel_variance)[rows]
        passes = np.ones(len(rows), bool)
        if self._options.gate:
            distance = self._distances(innovation, by_pose, by_point, slots, variance)
            passes = (distance <= self._threshold) & (in_camera[:, 2] > NEAREST)
        used, gated = np.zeros(len(frame.stereo.track), bool), np.zeros(len(frame.stereo.track), bool)
        used[rows[passes]], gated[rows[~passes]] = True, True
        if not passes.any():
            return used, gated, 0.0
        jacobian = _stacked(by_pose[passes], by_point[passes], slots[passes], size=len(self.cov))
        nis = self._correct(jacobian, variance[passes].reshape(-1), innovation[passes].reshape(-1))
        return used, gated, nis

    def _correct(self, jacobian: Array, variance: Array, innovation: Array) -> float:
        """Eq. (29)."""
        projected = jacobian @ self.cov
        spread = projected @ jacobian.T + np.diag(variance)
        weighted = _solution(spread, np.column_stack([projected, innovation]))
        gain = weighted[:, :-1].T
        correction = gain @ innovation
        kept = np.eye(len(self.cov)) - gain @ jacobian
        if self._options.covariance == "joseph":
            found = kept @ self.cov @ kept.T + (gain * variance) @ gain.T
            self.cov = 0.5 * (found + found.T)
        else:
            self.cov = kept @ self.cov
        self.world_T_imu = se3.retract(self.world_T_imu, self._options.pose_gain * correction[POSE])
        self.bias = self.bias + correction[BIAS]
        self.points_world = self.points_world + correction[NAV:].reshape(-1, 3)
        return float(innovation @ weighted[:, -1])

    def _jacobians(self, in_camera: Array, points_world: Array) -> tuple[Array, Array]:
        """Eqs. (26) and (19): derivatives ``(n, 3, 6)`` by the pose and ``(n, 3, 3)`` by the landmark."""
        rig = self._problem.rig
        by_camera = rig.projection_jacobian(in_camera)
        by_imu = by_camera @ rig.cam_T_imu[:3, :3]
        by_point = by_imu @ self.world_T_imu[:3, :3].T
        pose = self.world_T_imu if self._options.jacobian == "as_printed" else se3.inverse(self.world_T_imu)
        by_pose = by_imu @ circled_dot(se3.transform(pose, points_world))
        return (-by_pose if self._options.jacobian == "derived" else by_pose), by_point

    def _distances(
        self, innovation: Array, by_pose: Array, by_point: Array, slots: IntArray, variance: Array
    ) -> Array:
        """Squared Mahalanobis distance ``(n,)`` of each observation."""
        place = NAV + 3 * slots[:, None] + np.arange(3)
        own = np.concatenate([np.broadcast_to(np.arange(6), (len(slots), 6)), place], axis=1)
        jacobian = np.concatenate([by_pose, by_point], axis=2)
        spread = jacobian @ self.cov[own[:, :, None], own[:, None, :]] @ jacobian.transpose(0, 2, 1)
        spread += variance[:, :, None] * np.eye(3)
        weighted = _solution(spread, innovation[:, :, None])[:, :, 0]
        return np.asarray(np.sum(innovation * weighted, axis=1))

    def _append_independent(self, frame: Frame, rows: IntArray) -> None:
        """Place new landmarks at their first observation (eq. 20)."""
        prior = self._options.landmark_variance * np.eye(3 * len(rows))
        self._grow(self._first(frame, rows), np.zeros((3 * len(rows), len(self.cov))), prior)

    def _append_correlated(self, frame: Frame, rows: IntArray) -> None:
        """Place new landmarks at their first observation, with the covariance of pose and observation."""
        new, rig = self._first(frame, rows), self._problem.rig
        in_imu = se3.transform(rig.imu_T_cam, rig.back_project(frame.stereo.z[rows]))
        rotation = self.world_T_imu[:3, :3]
        grow = np.zeros((3 * len(rows), len(self.cov)))
        grow[:, POSE] = (rotation @ circled_dot(in_imu)).reshape(3 * len(rows), 6)
        noise = np.zeros((len(rows), 3, len(rows), 3))
        noise[np.arange(len(rows)), :, np.arange(len(rows))] = new.cov
        self._grow(new, grow, noise.reshape(3 * len(rows), 3 * len(rows)))

    def _first(self, frame: Frame, rows: IntArray) -> IndependentLandmarks:
        """Landmarks as an observation alone places them."""
        variance = pixel_variances(frame, self._options.pixel_variance)[rows]
        return initialise(
            self._problem.rig, self.world_T_imu, frame.stereo.track[rows], frame.stereo.z[rows], variance
        )

    def _grow(self, new: IndependentLandmarks, grow: Array, noise: Array) -> None:
        """Append landmarks whose error is ``grow`` times that of the state, plus noise."""
        cross = grow @ self.cov
        self.cov = np.block([[self.cov, cross.T], [cross, cross @ grow.T + noise]])
        self.track = np.concatenate([self.track, new.track])
        self.points_world = np.concatenate([self.points_world, new.points_world])

    def _drop(self, left: BoolArray) -> None:
        """Take landmarks ``(m,)`` out of the state, and remember them."""
        place = (NAV + 3 * np.flatnonzero(left))[:, None] + np.arange(3)
        cov = self.cov[place[:, :, None], place[:, None, :]]
        self._left.append(IndependentLandmarks(self.track[left], self.points_world[left], cov))
        rows = np.concatenate([np.ones(NAV, bool), np.repeat(~left, 3)])
        self.cov = self.cov[np.ix_(rows, rows)]
        self.track, self.points_world = self.track[~left], self.points_world[~left]


def circled_dot(points: Array) -> Array:
    """Derivative ``(n, 3, 6)`` of ``exp(xi) s`` at 0 for points s, ``(n, 3)``; xi = (omega, v).

    The report's circled-dot operator (eq. 26), which has (v, omega), with the rows that are not zero.
    """
    out = np.zeros((len(points), 3, 6))
    out[:, :, :3] = -so3.hat(points)
    out[:, :, 3:] = np.eye(3)
    return out


def _semi_definite(cov: Array) -> BoolArray:
    """Which of symmetric matrices ``(..., n, n)`` are covariances, but for rounding."""
    scale = np.abs(cov).max(axis=(-2, -1), initial=0.0)
    return np.asarray(np.linalg.eigvalsh(cov)[..., 0] >= -_ROUNDING * scale)


def _stacked(by_pose: Array, by_point: Array, slots: IntArray, *, size: int) -> Array:
    """H of eq. (28), ``(3n, size)``."""
    n = len(slots)
    jacobian = np.zeros((n, 3, size))
    jacobian[:, :, POSE] = by_pose
    columns = NAV + 3 * slots[:, None] + np.arange(3)
    jacobian[np.arange(n)[:, None, None], np.arange(3)[:, None], columns[:, None, :]] = by_point
    return jacobian.reshape(3 * n, size)


def _solution(spread: Array, right: Array) -> Array:
    """Solution of ``spread x = right``; the least one where a filter that has diverged left it singular."""
    try:
        return np.asarray(np.linalg.solve(spread, right), float)
    except np.linalg.LinAlgError:
        return np.asarray(np.linalg.pinv(spread) @ right, float)


def _places(track: IntArray, wanted: IntArray) -> IntArray:
    """Where in ``track (m,)`` the wanted ids ``(n,)`` are, all of which it has."""
    order = np.argsort(track)
    return np.asarray(order[np.searchsorted(track, wanted, sorter=order)])
