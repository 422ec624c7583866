"""Stereo odometry from frame to frame: the peer that knows no map."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from pydantic.dataclasses import dataclass

from vislam.base import settings
from vislam.base.fields import STRICT
from vislam.base.types import Array, IntArray
from vislam.core.estimator import Problem
from vislam.core.frame import Frame
from vislam.core.rigid_fit import FEWEST
from vislam.core.step import Final, Step
from vislam.geometry import se3
from vislam.models import odometry as motion
from vislam_baselines.observations import SMALLEST_DISPARITY
from vislam_baselines.stereo_step import Prior, StepFit, fit_step


@dataclass(frozen=True, slots=True, kw_only=True, config=STRICT)
class StereoVoOptions:
    """Options of the stereo odometry."""

    inertial: Literal["fallback", "prior"] = "fallback"
    """``fallback``: the inertial twist is the step where too few tracks go on; elsewhere the fit starts from
    it, no more. ``prior``: it is one more measurement of every step."""


def build(problem: Problem, options: Mapping[str, Any]) -> "StereoVo":
    """Build the stereo odometry from a problem and the options of its config section."""
    return StereoVo(problem, settings.parse(StereoVoOptions, dict(options), at="estimators.stereo_vo"))


class StereoVo:
    """Strings together the steps that the tracks of two successive frames make.

    The covariance treats steps as independent, which is an approximation: an observation ends one step and
    begins the next, a track keeps its stereo-matching bias, and inertial steps share their bias.
    """

    def __init__(self, problem: Problem, options: StereoVoOptions) -> None:
        self._problem = problem
        self._options = options
        self._world_T_imu = np.eye(4)
        self._cov = np.diag(problem.first_pose_sigma**2)
        self._before = (np.empty(0, np.int64), np.empty((0, 3)))
        self._fused: list[tuple[IntArray, IntArray]] = []
        self._inertial_steps = 0

    def process(self, frame: Frame) -> Step:
        """Take one frame."""
        stereo = frame.stereo
        valid = stereo.z[:, 0] - stereo.z[:, 1] > SMALLEST_DISPARITY
        allowed = np.flatnonzero(valid & stereo.usable)
        track, z = stereo.track[allowed], stereo.z[allowed]
        rows, fit = np.empty(0, np.int64), None
        if frame.k > 0:
            rows, fit = self._step(frame, track, z)
        self._before = (track, z)
        used = np.zeros(len(stereo), bool)
        used[allowed[rows]] = True
        return Step(
            pose=self._world_T_imu,
            pose_cov=self._cov.copy(),
            nis=0.0 if fit is None else fit.chi_square,
            dof=0 if fit is None else fit.dof,
            used=used,
            gated=~valid & stereo.usable,
        )

    def finalize(self) -> Final:
        """Leave the poses as they were; fused are the observations at both ends of the fitted steps."""
        frames, tracks = zip(*self._fused, strict=True) if self._fused else ((), ())
        nothing = np.empty(0, np.int64)
        return Final(
            fused=(np.concatenate([nothing, *frames]), np.concatenate([nothing, *tracks])),
            counts={"inertial_steps": self._inertial_steps},
        )

    def _step(self, frame: Frame, track: IntArray, z: Array) -> tuple[IntArray, StepFit | None]:
        """Go on to a frame by its tracks ``(n,)`` at ``(n, 3)``: which of them count, and the fit if any."""
        inertial = self._inertial(frame)
        track_before, z_before = self._before
        common, before, after = np.intersect1d(track_before, track, assume_unique=True, return_indices=True)
        fit = None
        if len(common) >= FEWEST:
            fit = fit_step(
                self._problem.rig,
                self._problem.track_noise,
                z_before[before],
                z[after],
                start=inertial.prev_T_next,
                prior=inertial if self._options.inertial == "prior" else None,
            )
        if fit is None:
            self._inertial_steps += 1
            self._advance(inertial.prev_T_next, inertial.cov)
            return np.empty(0, np.int64), None
        self._advance(fit.prev_T_next, fit.cov)
        for k in (frame.k - 1, frame.k):
            self._fused.append((np.full(int(fit.seen.sum()), k), common[fit.seen]))
        return after[fit.seen], fit

    def _inertial(self, frame: Frame) -> Prior:
        """Step by the twist less the prior mean of its bias, whose own uncertainty is part of the step's."""
        problem = self._problem
        step = motion.integrate(
            frame.odometry.twist, bias=problem.bias_mean, dt=frame.dt, noise=problem.noise
        )
        by_bias = step.by_bias * problem.bias_sigma
        return Prior(step.prev_T_next, step.cov + by_bias @ by_bias.T)

    def _advance(self, prev_T_next: Array, cov: Array) -> None:
        carry = se3.adjoint(se3.inverse(prev_T_next))
        self._cov = carry @ self._cov @ carry.T + cov
        self._world_T_imu = self._world_T_imu @ prev_T_next
