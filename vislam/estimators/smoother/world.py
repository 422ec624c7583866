"""The world that a smoother reports in: that of the first pose, as the filters have it.

Where the vertical velocity is in use, z of the graph's own world is the vertical, and the first pose is free
to be tilted against it. All poses and landmarks turn with each new estimate of that tilt, which says nothing
of the motion: a causal trajectory in that world would be put together of pieces that are tilted differently.
So what is reported is ``T_0^-1 T_k``, and the tilt as the direction of up in that world.

Where the rotation psi of the cameras is estimated, the variables are ``G_k``, poses of the body as the
cameras have it (:mod:`vislam.estimators.smoother.twist_errors`). With ``S_k = G_0^-1 G_k`` in the first case,
and ``G_k`` itself in the other, the body's pose and a point of the map are

    T_k = exp(psi_0) S_k exp(-psi_k),    p = exp(psi_0) p_S.

Covariances follow to first order from the joint ones of the graph's errors (Barfoot, *State Estimation for
Robotics*, 2nd ed., section 7.3): with ``e_k`` and ``e_0`` on the right of ``G_k`` and ``G_0``, d_k and d_0 of
psi, ``J_k = J_r(psi_k)``, and Ad that of ``exp(psi_k)``,

    e(T_k) = Ad (e_k - Ad(S_k^-1) (e_0 - J_0 d_0) - J_k d_k),

and of a point ``p_S = G_0^-1 p_w`` it is ``exp(psi_0) (R_0^T e_w + [p_S^, -I] e_0 - p_S^ J_0 d_0)``, without
the terms of what is not estimated. What is known of the first pose itself, its prior without the tilt, is in
the covariances as it is in a filter's.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.core.estimator import Problem
from vislam.geometry import se3, so3
from vislam.models.shared_errors import CAMERA_ROTATION

_Z = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Origin:
    """What poses and points of the graph are reported by, as estimated.

    Attributes
    ----------
    pose : (4, 4)
        ``G_0``; the identity where the world is not tilted.
    rotation : (3,)
        psi_0 [rad].
    """

    pose: Array
    rotation: Array


@dataclass(frozen=True)
class GraphCovariances:
    """Covariances of errors of the graph's variables, n of them of d numbers each.

    Attributes
    ----------
    own : (n, d, d)
    cross : (n, d, m)
        With the errors that they share: of the first pose (6) where it is tilted, of psi_0 (3) where it is
        turned, and then, of a pose if psi walks, of the psi of its own frame (3).
    shared : (m, m) or (n, m, m)
        Of the latter.
    """

    own: Array
    cross: Array
    shared: Array


class ReportedWorld:
    """The world of the first pose.

    Attributes
    ----------
    tilted : bool
        Whether the graph's own world is tilted against it.
    turned : bool
        Whether the graph's poses are those of the body as the cameras have it.
    """

    def __init__(self, problem: Problem) -> None:
        self.tilted = problem.vertical_velocity is not None
        self.turned = CAMERA_ROTATION in problem.shared()
        self._prior = np.diag(np.square(problem.first_pose_sigma))

    @property
    def own(self) -> bool:
        """Whether it is another world than the graph's, or other poses are."""
        return self.tilted or self.turned

    def poses(self, origin: Origin, poses: Array, rotation: Array) -> Array:
        """Poses ``(..., 4, 4)`` of the graph in this world; ``rotation (..., 3)`` are psi at their frames."""
        found = se3.inverse(origin.pose) @ poses if self.tilted else poses
        if self.turned:
            found = _turn(origin.rotation) @ found @ _turn(-rotation)
        return np.asarray(found)

    def points(self, origin: Origin, points: Array) -> Array:
        """Points ``(n, 3)`` likewise."""
        if self.tilted:
            points = (points - origin.pose[:3, 3]) @ origin.pose[:3, :3]
        return np.asarray(points @ so3.exp(-origin.rotation)) if self.turned else points

    def up(self, origin: Origin) -> Array | None:
        """Direction ``(3,)`` of up; None where it is not estimated."""
        if not self.tilted:
            return None
        return np.asarray(so3.exp(origin.rotation) @ origin.pose[:3, :3].T @ _Z)

    def pose_covariances(
        self, origin: Origin, poses: Array, rotation: Array, known: GraphCovariances
    ) -> Array:
        """Covariances ``(n, 6, 6)`` on the right of poses in this world.

        Parameters
        ----------
        origin : Origin
        poses : (n, 4, 4)
            In the graph's world.
        rotation : (n, 3)
            psi at their frames.
        known : GraphCovariances
            Of the poses in the graph's world.
        """
        size = known.cross.shape[2]
        inner = se3.inverse(origin.pose) @ poses if self.tilted else poses
        back = se3.adjoint(se3.inverse(inner))
        by_shared = np.zeros((len(poses), 6, size))
        at = 6 if self.tilted else 0
        if self.tilted:
            by_shared[:, :, :6] = -back
        if self.turned:
            by_shared[:, :, at : at + 3] = back[:, :, :3] @ so3.left_jacobian(-origin.rotation)
            own = slice(at + 3, at + 6) if size > at + 3 else slice(at, at + 3)
            by_shared[:, :3, own] -= so3.left_jacobian(-rotation)
        found = self._mapped(by_shared, known)
        if not self.turned:
            return found
        turn = se3.adjoint(_turn(rotation))
        return np.asarray(turn @ found @ turn.transpose(0, 2, 1))

    def point_covariances(self, origin: Origin, points: Array, known: GraphCovariances) -> Array:
        """Covariances ``(n, 3, 3)`` of points in this world.

        Parameters
        ----------
        origin : Origin
        points : (n, 3)
            In this world.
        known : GraphCovariances
            Of the points in the graph's world.
        """
        inner = points @ so3.exp(origin.rotation) if self.turned else points
        hat = so3.hat(inner)
        by_shared = np.zeros((len(points), 3, known.cross.shape[2]))
        at = 6 if self.tilted else 0
        if self.tilted:
            by_shared[:, :, :3], by_shared[:, :, 3:6] = hat, -np.eye(3)
        if self.turned:
            by_shared[:, :, at : at + 3] = -hat @ so3.left_jacobian(-origin.rotation)
        turn = origin.pose[:3, :3].T
        turned = GraphCovariances(turn @ known.own @ turn.T, turn @ known.cross, known.shared)
        found = self._mapped(by_shared, turned)
        if not self.turned:
            return found
        outer = so3.exp(origin.rotation)
        return np.asarray(outer @ found @ outer.T)

    def _mapped(self, by_shared: Array, known: GraphCovariances) -> Array:
        """Covariance of ``e + Q g`` of errors e and shared ones g, with what is known of the first pose."""
        shared = known.shared
        if self.tilted:
            shared = shared.copy()
            shared[..., :6, :6] += self._prior
        mixed = known.cross @ by_shared.transpose(0, 2, 1)
        spread = by_shared @ shared @ by_shared.transpose(0, 2, 1)
        return np.asarray(known.own + mixed + mixed.transpose(0, 2, 1) + spread)


def _turn(rotation: Array) -> Array:
    """Pose ``(..., 4, 4)`` that turns by a rotation vector ``(..., 3)``."""
    return se3.from_rotation_translation(so3.exp(rotation), np.zeros(rotation.shape))
