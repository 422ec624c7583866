"""What the recorded twist is off by all along, from all tracks of a recording together.

Where a step shows too few tracks to tell its motion, the tracks of all steps together still tell what the
twist is off by in every one of them: its bias, and the direction of its velocity, which errs in proportion to
the speed. With the twist u of a step and its error ``e = (b_w, b_v + g u_x)``, a point p of the body frame
before is seen, in the body frame after, at

    exp(-dt (u - e)) p = exp(-dt u) exp(dt J e) p,

with J the right Jacobian at ``-dt u``. So a residual against the recorded motion is linear in nine numbers: a
robust regression over all pairs of successive observations (Geman-McClure weights, as the vote of one step
has).
"""

from dataclasses import dataclass

import numpy as np

from vislam.base import linear
from vislam.base.types import Array, BoolArray, IntArray
from vislam.core.rigid_fit import (
    MIXING,
    Continuations,
    continuations,
    inertial_steps,
    robust_scale,
    robust_weight,
    step_spread,
)
from vislam.core.sequence import Sequence
from vislam.geometry import se3, so3

FEWEST_PAIRS = 60
"""Fewer pairs of observations than this tell nothing."""
_ENOUGH = 10_000
"""Of more pairs than this a part is taken."""
_ITERATIONS = 20
_BLOCKS = 12
_RIDGE = 1e-12
_EXPLAINED = 0.5
"""A twist that leaves more than this share of the flow has nothing to say of it: wrong axes, wrong units."""
_SHARE_SIGMA = np.array([0.05, 0.03, 0.03])
"""Prior of the shares of the forward velocity: scale of the camera, and two small angles [rad]. At a speed
that hardly changes a bias cannot be told from them, and without it each would take what the other gives."""


@dataclass(frozen=True)
class InertialPairs:
    """Pairs of successive observations of a track against the recorded motion.

    Attributes
    ----------
    pairs : Continuations
    frame : (m,)
        Frame of the second of each.
    residual : (m, 3)
        Of (mean column, disparity, row), in units of a spread whose scale is not known.
    by_error : (m, 3, 6)
        Its derivative by what is to be taken off the twist of its step; seen less predicted falls by it.
    forward : (m,)
        Recorded forward velocity of the step [m/s].
    flow : (m, 3)
        Residual as if nothing had moved.
    """

    pairs: Continuations
    frame: IntArray
    residual: Array
    by_error: Array
    forward: Array
    flow: Array


@dataclass(frozen=True)
class TwistError:
    """Error of the recorded twist in all steps.

    Attributes
    ----------
    bias : (6,)
        At standstill [rad/s, m/s].
    direction : (3,)
        What the velocity is off by, as shares of its forward component.
    cov : (9, 9)
        Covariance of both, by blocks of the recording and by its residuals.
    scale : float
        Robust standard deviation of the residuals, in units of their spread.
    """

    bias: Array
    direction: Array
    cov: Array
    scale: float

    @property
    def mean(self) -> Array:
        """Both, ``(9,)``."""
        return np.concatenate([self.bias, self.direction])


def inertial_pairs(sequence: Sequence) -> InertialPairs:
    """Hold all tracks that go on against the recorded twist; disparities must be above zero."""
    rig, pairs, z = sequence.rig, continuations(sequence), sequence.z
    frame = sequence.frame_of[pairs.after]
    means, _ = sequence.step_means()
    dt = np.diff(sequence.stamp, prepend=sequence.stamp[0])
    step = inertial_steps(sequence)[frame]
    body = se3.transform(rig.imu_T_cam, rig.back_project(z[pairs.before]))
    moved = se3.transform(rig.cam_T_imu, se3.transform(step, body[:, None])[:, 0])
    moved = np.column_stack([moved[:, :2], np.maximum(moved[:, 2], rig.nearest)])
    spread = step_spread(sequence.disparity[pairs.before])
    right = se3.right_jacobian(-means * dt[:, None])[frame]
    turned = rig.cam_T_imu[:3, :3] @ step[:, :3, :3]
    fixed = np.broadcast_to(np.eye(3), (len(body), 3, 3))
    by_motion = turned @ np.concatenate([-so3.hat(body), fixed], axis=2)
    jacobian = MIXING @ rig.projection_jacobian(moved) @ by_motion @ right * dt[frame][:, None, None]
    return InertialPairs(
        pairs,
        frame,
        (z[pairs.after] - rig.project(moved)) @ MIXING.T / spread,
        jacobian / spread[:, :, None],
        means[frame, 3],
        (z[pairs.after] - z[pairs.before]) @ MIXING.T / spread,
    )


def twist_error(found: InertialPairs) -> TwistError | None:
    """Error of the twist from all pairs; None where they are too few, or do not move as the twist says."""
    if len(found.frame) < FEWEST_PAIRS:
        return None
    unexplained = robust_scale(np.sum(found.residual**2, axis=1))
    if unexplained > _EXPLAINED * robust_scale(np.sum(found.flow**2, axis=1)):
        return None
    some = slice(None, None, max(1, len(found.frame) // _ENOUGH))
    frame, residual, by_error = found.frame[some], found.residual[some], found.by_error[some]
    along = by_error[:, :, 3:] * found.forward[some, None, None]
    design = np.concatenate([by_error, along], axis=2)
    error: Array = np.zeros(9)
    for _ in range(_ITERATIONS):
        square = np.sum((residual - design @ error) ** 2, axis=1)
        scale = robust_scale(square)
        weight = robust_weight(square, scale)
        before, error = error, _solved(design, residual, weight, scale)
        if np.all(np.abs(error - before) < 1e-9):
            break
    left_out = np.array(
        [_solved(design, residual, weight * ~part, scale) for part in _parts(frame) if not part.all()]
    )
    spread = left_out - left_out.mean(axis=0)
    jackknife = (len(left_out) - 1) / len(left_out) * spread.T @ spread
    cov = jackknife + scale**2 * linear.inverse(_information(design, weight, scale))
    return TwistError(error[:6], error[6:], cov, scale)


def _parts(frame: IntArray) -> list[BoolArray]:
    """Masks of the blocks of a recording, of as many frames each."""
    edges = np.linspace(frame.min(), frame.max() + 1, _BLOCKS + 1)
    block = np.searchsorted(edges, frame, side="right") - 1
    return [block == index for index in np.unique(block)]


def _information(design: Array, weight: Array, scale: float) -> Array:
    information = np.einsum("m,mri,mrj->ij", weight, design, design, optimize=True)
    prior = np.concatenate([np.full(6, _RIDGE), (scale / _SHARE_SIGMA) ** 2])
    return np.asarray(information + np.diag(prior))


def _solved(design: Array, residual: Array, weight: Array, scale: float) -> Array:
    right = np.einsum("m,mri,mr->i", weight, design, residual, optimize=True)
    return linear.solve(_information(design, weight, scale), right)
