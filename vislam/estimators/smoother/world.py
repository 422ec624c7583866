"""The world that a smoother reports in: that of the first pose, as the filters have it.

Where the vertical velocity is in use, z of the graph's own world is the vertical, and the first pose is free
to be tilted against it. All poses and landmarks turn with each new estimate of that tilt, which says nothing
of the motion: a causal trajectory in that world would be put together of pieces that are tilted differently.
So what is reported is ``T_0^-1 T_k``, and the tilt as the direction of up in that world.

With the errors ``e_k`` on the right of the poses the error of ``T_0^-1 T_k`` is to first order
``e_k - Ad(T_k^-1 T_0) e_0`` (Barfoot, *State Estimation for Robotics*, 2nd ed., section 7.3), and that of a
point ``p = T_0^-1 p_w`` is ``R_0^T e_w + [p^, -I] e_0``. What is known of the first pose itself, its prior
without the tilt, is in the covariances as it is in a filter's.
"""

import numpy as np

from vislam.base.types import Array
from vislam.core.estimator import Problem
from vislam.geometry import se3, so3

_Z = np.array([0.0, 0.0, 1.0])


class ReportedWorld:
    """The world of the first pose.

    Attributes
    ----------
    tilted : bool
        Whether the graph's own world is another one.
    """

    def __init__(self, problem: Problem) -> None:
        self.tilted = problem.vertical_velocity is not None
        self._prior = np.diag(np.square(problem.first_pose_sigma))

    def poses(self, first: Array, poses: Array) -> Array:
        """Poses ``(..., 4, 4)`` of the graph's world, whose first one is ``first (4, 4)``, in this one."""
        return np.asarray(se3.inverse(first) @ poses) if self.tilted else poses

    def points(self, first: Array, points: Array) -> Array:
        """Points ``(n, 3)`` likewise."""
        return np.asarray((points - first[:3, 3]) @ first[:3, :3]) if self.tilted else points

    def up(self, first: Array) -> Array | None:
        """Direction ``(3,)`` of up; None where it is not estimated."""
        return np.asarray(first[:3, :3].T @ _Z) if self.tilted else None

    def pose_covariances(self, poses: Array, cov: Array, cross: Array, first_cov: Array) -> Array:
        """Covariances on the right of poses in this world.

        Parameters
        ----------
        poses : (n, 4, 4)
            In this world.
        cov : (n, 6, 6)
            In the graph's.
        cross : (n, 6, 6)
            Between the errors of the poses and of the first.
        first_cov : (6, 6)
            Of the first pose in the graph's world.
        """
        back = se3.adjoint(se3.inverse(poses))
        mixed = cross @ back.transpose(0, 2, 1)
        spread = back @ (first_cov + self._prior) @ back.transpose(0, 2, 1)
        return np.asarray(cov - mixed - mixed.transpose(0, 2, 1) + spread)

    def point_covariances(
        self, points: Array, cov: Array, cross: Array, first_cov: Array, first: Array
    ) -> Array:
        """Covariances ``(n, 3, 3)`` of points ``(n, 3)`` in this world; ``cross`` is ``(n, 3, 6)``."""
        turn = first[:3, :3].T
        by_first = np.concatenate([so3.hat(points), np.broadcast_to(-np.eye(3), (len(points), 3, 3))], axis=2)
        mixed = turn @ cross @ by_first.transpose(0, 2, 1)
        spread = by_first @ (first_cov + self._prior) @ by_first.transpose(0, 2, 1)
        return np.asarray(turn @ cov @ turn.T + mixed + mixed.transpose(0, 2, 1) + spread)
