"""Motion of the body between two frames from the stereo tracks that they share, by a robust fit.

A track is triangulated in the earlier frame and seen from the later. Each residual has a covariance of its
own: white noise of both frames, a step of the tracker's drift, and the stereo-matching bias of the track,
which puts the point at a wrong depth and comes again in the later disparity.
:func:`vislam.core.rigid_fit.fit_rigid`, by which the repairs vote, knows none of these: its spread depends on
the disparity alone, and its scale is fitted.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from vislam.base.types import Array, BoolArray
from vislam.core.rigid_fit import FEWEST
from vislam.geometry import se3
from vislam.models import StereoRig, TrackNoise
from vislam_baselines.observations import NEAREST, Observations, look

_FREEDOM = 2.0
"""Degrees of freedom of the Student distribution that residuals of recorded tracks have."""
_INFORMATION = (_FREEDOM + 3.0) / (_FREEDOM + 5.0)
"""Its information on a motion, as a share of what the weighted Hessian comes to on average."""
_ITERATIONS = 30
_AT_REST = 1e-2
"""Iterations end when the motion changes by less than this share of its standard deviation."""
_DRIFT = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
"""Covariance of (uL, uR, v) when column and row drift by a unit each: both columns do so together."""


@dataclass(frozen=True)
class Prior:
    """What is known of a motion without looking.

    Attributes
    ----------
    prev_T_next : (4, 4)
    cov : (6, 6)
        Its covariance, on its right.
    """

    prev_T_next: Array
    cov: Array

    def residual(self, motion: Array) -> tuple[Array, Array]:
        """How far a motion is from it, ``(6,)`` in its own units, and the derivative ``(6, 6)`` of that."""
        root = np.linalg.cholesky(self.cov)
        error = se3.local(self.prev_T_next, motion)
        return np.linalg.solve(root, error), np.linalg.inv(se3.right_jacobian(error) @ root)


@dataclass(frozen=True)
class StepFit:
    """Fitted motion of the body.

    Attributes
    ----------
    prev_T_next : (4, 4)
    cov : (6, 6)
        Inverse of the information of the weights' distribution, on its right.
    seen : (n,)
        Which of the tracks the fit rests on: those in front of the camera.
    weight : (n,)
        What remains of each: (2 + 3) / 2 for one that fits exactly, next to 0 for one that does not.
    chi_square, dof : float, int
        Sum of the weighted squared residuals and its degrees of freedom, which are its mean if the residuals
        have the distribution that the weights are of.
    """

    prev_T_next: Array
    cov: Array
    seen: BoolArray
    weight: Array
    chi_square: float
    dof: int


def fit_step(
    rig: StereoRig,
    noise: TrackNoise,
    before: Array,
    after: Array,
    *,
    start: Array,
    prior: Prior | None = None,
) -> StepFit | None:
    """Fit the motion between two frames by iteratively reweighted Gauss-Newton.

    Weights and information are those of a Student distribution (Lange, Little and Taylor, JASA 84, 1989).

    Parameters
    ----------
    rig : StereoRig
    noise : TrackNoise
    before, after : (n, 3)
        Measurements (uL, uR, v) of the same tracks [px], their disparities above zero.
    start : (4, 4)
        Motion ``prev_T_next`` of the body to start from.
    prior : Prior, optional
        Taken as one more measurement.

    Returns
    -------
    StepFit or None
        None if the tracks do not tell the motion.
    """
    points = rig.back_project(before)
    in_imu = se3.transform(rig.imu_T_cam, points)
    motion = start
    for _ in range(_ITERATIONS):
        observations = look(rig, motion, in_imu)
        seen = observations.depth > NEAREST
        if np.count_nonzero(seen) < FEWEST:
            return None
        spread = residual_cov(rig, noise, before, points, observations)
        residual, jacobian = _whitened(after - observations.z, observations.by_pose, spread)
        square = np.einsum("ni,ni->n", residual, residual)
        weight = seen * (_FREEDOM + 3.0) / (_FREEDOM + square)
        weighted = (weight[:, None, None] * jacobian).reshape(-1, 6)
        hessian, gradient = weighted.T @ jacobian.reshape(-1, 6), weighted.T @ residual.reshape(-1)
        error, by_motion = (np.zeros(0), np.zeros((0, 6))) if prior is None else prior.residual(motion)
        own = by_motion.T @ by_motion
        try:
            factor = cho_factor(hessian + own)
        except np.linalg.LinAlgError:
            return None
        downhill = gradient - by_motion.T @ error
        step = cho_solve(factor, downhill)
        motion = se3.retract(motion, step)
        if step @ downhill < _AT_REST**2:
            break
    return StepFit(
        prev_T_next=motion,
        cov=np.linalg.inv(_INFORMATION * hessian + own),
        seen=seen,
        weight=weight,
        chi_square=float(weight @ square + error @ error),
        dof=3 * int(np.count_nonzero(seen)) - 6 + len(error),
    )


def _whitened(residual: Array, jacobian: Array, cov: Array) -> tuple[Array, Array]:
    """Residuals ``(n, 3)`` and their derivatives ``(n, 3, 6)`` in units of the residuals' noise."""
    both = np.concatenate([residual[:, :, None], jacobian], axis=2)
    white = np.linalg.solve(np.linalg.cholesky(cov), both)
    return white[:, :, 0], white[:, :, 1:]


def residual_cov(
    rig: StereoRig, noise: TrackNoise, before: Array, points: Array, observations: Observations
) -> Array:
    """Covariance ``(n, 3, 3)`` [px^2] of measured less predicted.

    Parameters
    ----------
    rig : StereoRig
    noise : TrackNoise
    before, points : (n, 3)
        Earlier measurements [px], and the points in the earlier camera that they make [m].
    observations : Observations
        Of these points, from the later frame.
    """
    white = np.diag(noise.sigma**2)
    by_camera = observations.by_point @ rig.imu_T_cam[:3, :3]
    by_before = by_camera @ rig.back_projection_jacobian(before)
    # With its stereo-matching bias e a track's point is 1 + e times as far away, and so is every disparity of
    # it.
    by_match = (by_camera @ points[:, :, None])[:, :, 0]
    by_match[:, 1] -= observations.z[:, 0] - observations.z[:, 1]
    by_match *= noise.match_sigma(before[:, 0] - before[:, 1])[:, None]
    carried = by_before @ white @ by_before.transpose(0, 2, 1)
    return white + noise.drift**2 * _DRIFT + carried + by_match[:, :, None] * by_match[:, None, :]
