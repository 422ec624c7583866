"""The motion model that every estimator calls: twist integration with a bias, its F and its Q.

The recorded twist u carries a bias b and white noise. Over a step of length dt

    T_k = T_{k-1} exp(dt (u - b)) exp(w),    b_k = b_{k-1} + w_b,

with w of covariance ``J diag(density^2) J^T dt`` (J the right Jacobian at the step) and w_b of
covariance ``diag(walk^2) dt``. It is integration on SE(3) (Barfoot, *State Estimation for
Robotics*, 2017, section 7.2); the course report's eq. 23 is the special case without a bias.

Where the velocity's direction a in the body is estimated, two small angles to the left and up [rad], the
recorded velocity is off by ``u_x a`` beside its bias: a body whose axes are not those of its instrument sees
its forward velocity across itself, the faster, the more. So b is ``b + u_x E a`` throughout, with E
(:data:`ACROSS`) the two axes across; a is constant.
"""

from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array
from vislam.geometry import se3

ACROSS = np.eye(6)[:, 4:]
"""From the direction of the velocity (left, up) to the twist that a unit of forward velocity has by it, ``(6,
2)``."""
POSE = slice(0, 6)
"""Where the pose stands in the navigation state."""
BIAS = slice(6, 12)
"""Where the twist bias stands in the navigation state."""
NAV = 12
"""Size of the navigation state (pose, bias)."""


@dataclass(frozen=True)
class MotionNoise:
    """Densities of the inertial noise.

    Attributes
    ----------
    twist : (6,)
        White noise of the twist (omega, v) [rad/sqrt(s), m/sqrt(s)].
    bias_walk : (6,)
        Random walk of the bias [rad/s/sqrt(s), m/s/sqrt(s)].
    acceleration : (6,) or None
        White noise of the acceleration of the body itself, along its own axes: how smoothly it moves
        [rad/s/sqrt(s), m/s/sqrt(s)]. None: nothing is supposed of it.
    """

    twist: Array
    bias_walk: Array
    acceleration: Array | None = None


@dataclass(frozen=True)
class Step:
    """One integrated step.

    Attributes
    ----------
    prev_T_next : (4, 4)
        The motion.
    by_bias : (6, 6)
        Derivative of the motion, on its right, with respect to the bias.
    cov : (6, 6)
        Covariance of the motion, on its right.
    bias_cov : (6, 6)
        Covariance of the bias walk over the step.
    """

    prev_T_next: Array
    by_bias: Array
    cov: Array
    bias_cov: Array


def integrate(twist: Array, *, bias: Array, dt: float, noise: MotionNoise) -> Step:
    """Integrate a twist ``(6,)`` less its bias ``(6,)`` over ``dt`` [s]."""
    xi = dt * (twist - bias)
    jacobian = se3.right_jacobian(xi)
    return Step(
        prev_T_next=se3.exp(xi),
        by_bias=-dt * jacobian,
        cov=dt * (jacobian * noise.twist**2) @ jacobian.T,
        bias_cov=dt * np.diag(noise.bias_walk**2),
    )


def transition(step: Step) -> tuple[Array, Array]:
    """F and Q ``(12, 12)`` of the navigation error (pose, bias) over a step.

    With the error on the right, ``eps' = Ad(prev_T_next^-1) eps + by_bias db + w`` (Sola, Deray, Atchuthan,
    *A micro Lie theory*, 2018, section II); the course report's eq. 25 with the bias added.
    """
    transition_matrix = np.eye(NAV)
    transition_matrix[POSE, POSE] = se3.adjoint(se3.inverse(step.prev_T_next))
    transition_matrix[POSE, BIAS] = step.by_bias
    noise = np.zeros((NAV, NAV))
    noise[POSE, POSE] = step.cov
    noise[BIAS, BIAS] = step.bias_cov
    return transition_matrix, noise
