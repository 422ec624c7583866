"""EKF SLAM, one frame at a time: retire, predict, gate, update, initialise."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic.dataclasses import dataclass
from scipy.stats import chi2

from vislam import config, motion
from vislam.data.sequence import Frame
from vislam.ekf import measurement
from vislam.ekf.state import JointState
from vislam.estimator import Estimate, Problem, StepRecord
from vislam.fields import STRICT
from vislam.motion import BIAS, POSE
from vislam.sensors import TrackNoise
from vislam.types import Array, BoolArray, IntArray

_NEAREST = 0.5
"""A landmark predicted nearer than this, or behind the camera, is not fused [m]."""


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class EkfOptions:
    """Options of the filter."""

    gate: bool = True
    """Refuse observations by a chi-square test of their innovation."""
    track_errors: Literal["states", "independent"] = "states"
    """``states``: drift and match error of each track are part of the state. ``independent``: they are taken
    for white noise of the same mean variance, as a smoother of plain stereo factors has to."""


def build(problem: Problem, options: Mapping[str, Any]) -> "EkfEstimator":
    """Build the filter from a problem and the options of its config section."""
    return EkfEstimator(problem, config.parse(EkfOptions, dict(options), at="estimators.ekf"))


class EkfEstimator:
    """Joint EKF over pose, bias and the landmarks in view (report, section III-D).

    A landmark leaves the state when its track ends. It would never be measured again, so the rest of
    the state is as if it had stayed; its own last mean and covariance are kept.
    """

    def __init__(self, problem: Problem, options: EkfOptions) -> None:
        self._problem = problem
        self._independent = options.track_errors == "independent"
        self._track_noise = TrackNoise(0.0, 0.0, 0.0) if self._independent else problem.track_noise
        self._threshold = float(chi2.ppf(problem.gate_probability, 3)) if options.gate else np.inf
        self.state = JointState(
            pose_sigma=problem.first_pose_sigma, bias=problem.bias_mean, bias_sigma=problem.bias_sigma
        )
        self._poses: list[Array] = []
        self._finished: list[tuple[IntArray, Array, Array]] = []
        self._matches: list[Array] = []

    def process(self, frame: Frame, refused: BoolArray) -> StepRecord:
        """Take one frame."""
        state = self.state
        self._retire(np.isin(state.track, frame.track, assume_unique=True))
        if frame.k > 0:
            step = motion.integrate(frame.twist, bias=state.bias, dt=frame.dt, noise=self._problem.noise)
            state.predict(step.prev_T_next, *motion.transition(step))
            self._drift()
        _, slots, rows = np.intersect1d(state.track, frame.track, assume_unique=True, return_indices=True)
        fused, gated, nis, log_likelihood = self._fuse(frame, slots, rows, ~refused[rows])
        new = ~np.isin(frame.track, state.track, assume_unique=True) & ~refused
        self._initialise(frame, new)
        used, all_gated = new, np.zeros(len(frame.track), bool)
        used[rows[fused]] = True
        all_gated[rows[gated]] = True
        self._poses.append(state.world_T_imu)
        return StepRecord(
            world_T_imu=state.world_T_imu,
            pose_cov=state.cov[POSE, POSE].copy(),
            bias=state.bias.copy(),
            bias_sigma=np.sqrt(np.diagonal(state.cov)[BIAS]),
            nis=nis,
            dof=3 * int(fused.sum()),
            log_likelihood=log_likelihood,
            used=used,
            gated=all_gated,
        )

    def finalize(self) -> Estimate:
        """Return the causal poses, and each landmark as it was when its track ended."""
        self._retire(np.zeros(len(self.state.track), bool))
        track, points, cov = (np.concatenate(part) for part in zip(*self._finished, strict=True))
        order = np.argsort(track)
        return Estimate(np.array(self._poses), track[order], points[order], cov[order], {})

    def match_errors(self) -> tuple[IntArray, Array, Array]:
        """Tracks that have ended, their match errors and the variances of these, ``(m,)`` each."""
        table = np.concatenate(self._matches)
        return table[:, 0].astype(np.int64), table[:, 1], table[:, 2]

    def _fuse(
        self, frame: Frame, slots: IntArray, rows: IntArray, allowed: BoolArray
    ) -> tuple[BoolArray, BoolArray, float, float]:
        """Gate and fuse the landmarks in ``slots``, seen in ``rows``.

        Returns the masks of fused and gated, the NIS and the log likelihood of what was fused.
        """
        nothing = np.zeros(len(slots), bool)
        if not allowed.any():
            return nothing, nothing, 0.0, 0.0
        prediction = measurement.predict(
            self._problem.rig, self.state.world_T_imu, self.state.landmarks[slots]
        )
        cross, spread = measurement.covariances(self.state, slots, prediction)
        each = np.arange(len(slots))
        spread[each[:, None], np.arange(3), each[:, None], np.arange(3)] += self._variance(frame)[rows]
        innovation = frame.z[rows] - prediction.z
        own = spread[each, :, each, :]
        distance = np.einsum("ni,ni->n", innovation, np.linalg.solve(own, innovation[..., None])[..., 0])
        passes = (distance <= self._threshold) & (prediction.depth > _NEAREST)
        good = allowed & passes
        if not good.any():
            return nothing, allowed & ~passes, 0.0, 0.0
        size, m = len(self.state.cov), 3 * int(good.sum())
        nis, log_det = self.state.update(
            cross[:, good].reshape(size, m),
            spread[good][:, :, good].reshape(m, m),
            innovation[good].reshape(m),
        )
        log_likelihood = -0.5 * (nis + log_det + m * float(np.log(2.0 * np.pi)))
        return good, allowed & ~passes, nis, log_likelihood

    def _initialise(self, frame: Frame, new: BoolArray) -> None:
        if not new.any():
            return
        landmarks, by_pose, by_measurement = measurement.initialise(
            self._problem.rig, self.state.world_T_imu, frame.z[new]
        )
        match = self._track_noise.match_sigma(frame.z[new, 0] - frame.z[new, 1])
        self.state.augment(
            frame.track[new],
            landmarks,
            by_pose=by_pose,
            by_measurement=by_measurement,
            noise=np.column_stack([self._variance(frame)[new], match**2]),
        )

    def _variance(self, frame: Frame) -> Array:
        """Variances ``(n, 3)`` [px^2] of the white noise of a frame's measurements."""
        if self._independent:
            return frame.sigma**2
        return np.broadcast_to(self._track_noise.sigma**2, frame.z.shape)

    def _drift(self) -> None:
        """Let the tracks in view drift on by a frame."""
        drift = self._track_noise.drift
        if drift == 0.0:
            return
        rig, state = self._problem.rig, self.state
        state.wander(measurement.drift_cov(rig, state.world_T_imu, state.landmarks[:, :3], drift=drift))

    def _retire(self, seen: BoolArray) -> None:
        if seen.all() and self._finished:
            return
        state = self.state
        cov = state.landmark_cov()
        self._finished.append((state.track[~seen], state.landmarks[~seen, :3], cov[~seen]))
        self._matches.append(
            np.column_stack([state.track, state.landmarks[:, 3], state.match_variance()])[~seen]
        )
        state.keep(seen)
