"""Raw inertia as the filter's model of motion: velocity and biases in the state, preintegrated steps.

With the pose error ``(theta, rho)`` on its right, all else additive and the velocity in the world, an error
before a step of length t and relative motion ``(R, p, v)`` is behind it, by differentiating
:meth:`vislam.models.preintegration.Preintegrated.predict`,

    theta' = R^T theta + theta_b db + n_theta,
    rho'   = R^T (rho - hat(p) theta + R_i^T dv t + p_b db + n_p),
    dv'    = dv - R_i hat(v) theta + R_i (v_b db + n_v),

where ``theta_b, p_b, v_b`` are the derivatives by the biases. What the biases change by within the step is
correlated with the motion, and both enter with their joint covariance. Gravity is in none of this: it acts
through the attitude, which roll and pitch of the first pose begin.

A turn about the vertical and a move of the whole world, velocity included, go through these equations as what
they are, whatever the estimate is: they are the four directions that nothing observes.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from vislam.base.types import Array
from vislam.core.estimator import Inertia, Problem
from vislam.core.frame import Frame
from vislam.core.imu import ImuStep
from vislam.estimators.ekf.layout import NavLayout
from vislam.estimators.ekf.propagation import Block, Measurement, Propagation
from vislam.geometry import se3, so3
from vislam.models.imu import ACCEL_BIAS, GYRO_BIAS, IMU_NAV, STATES, VELOCITY
from vislam.models.preintegration import Preintegrated


class InertialMotion:
    """Accelerometer and gyro. Blocks: ``velocity``, ``gyro_bias``, ``accel_bias`` (3 each)."""

    states = STATES

    def __init__(self, problem: Problem) -> None:
        assert problem.imu is not None
        self._inertia: Inertia = problem.imu
        self.information: Mapping[str, str] = problem.imu.information
        self._gravity = self._inertia.noise.gravity_world

    def blocks(self) -> Mapping[str, Block]:
        """Blocks in use; their covariance is that of the whole prior."""
        prior = self._inertia.prior
        sigma = np.sqrt(np.diagonal(prior.cov))
        return {
            VELOCITY: Block(prior.velocity, sigma[6:9]),
            GYRO_BIAS: Block(prior.gyro_bias, sigma[9:12]),
            ACCEL_BIAS: Block(prior.accel_bias, sigma[12:]),
        }

    def first(self, layout: NavLayout, nav: Array, frame: Frame) -> Array:
        """Return the prior mean."""
        del layout, frame
        return nav

    def propagate(self, layout: NavLayout, world_T_imu: Array, nav: Array, frame: Frame) -> Propagation:
        """Preintegrate the samples less the biases, and let gravity act."""
        assert frame.imu is not None
        step = self._preintegrated(layout, nav, frame.imu)
        velocity = nav[layout[VELOCITY]]
        pose, faster = step.predict(world_T_imu, velocity, self._gravity)
        change = np.zeros(layout.size)
        change[layout[VELOCITY]] = faster - velocity
        transition, noise = _linear(layout, world_T_imu[:3, :3], step)
        # The turn as it is: R^T R times it would take what R is off a rotation along, threefold at each step.
        moved = (pose[:3, 3] - world_T_imu[:3, 3]) @ world_T_imu[:3, :3]
        prev_T_next = se3.from_rotation_translation(step.rotation, moved)
        return Propagation(prev_T_next, change, transition, noise)

    def measurements(
        self, layout: NavLayout, world_T_imu: Array, nav: Array, frame: Frame
    ) -> Sequence[Measurement]:
        """Measure the velocity where the body stands still: zero, along the axes of the body.

        ``h = R^T v`` with ``H = (hat(R^T v), R^T)`` of attitude and velocity. It is the same number as the
        velocity in the world, turned, but no motion of the world ``(omega, u)`` changes it, wherever it is
        linearised: ``hat(R^T v) R^T omega + R^T (omega x v) = 0``. A residual in the world would tell of the
        heading as long as the estimate moves.
        """
        still = self._inertia.standstill
        if still is None or not still.frames[frame.k]:
            return []
        back = world_T_imu[:3, :3].T
        velocity = back @ nav[layout[VELOCITY]]
        by_nav = np.zeros((3, layout.size))
        by_nav[:, :3], by_nav[:, layout[VELOCITY]] = so3.hat(velocity), back
        return [Measurement(-velocity, by_nav, np.full(3, still.sigma**2))]

    def up(self, layout: NavLayout, nav: Array) -> Array | None:
        """The z axis is up."""
        del layout, nav
        return None

    def _preintegrated(self, layout: NavLayout, nav: Array, step: ImuStep) -> Preintegrated:
        biases = nav[layout[GYRO_BIAS]], nav[layout[ACCEL_BIAS]]
        return step.preintegrated(self._inertia.noise, *biases)


def _linear(layout: NavLayout, turn: Array, step: Preintegrated) -> tuple[Array, Array]:
    """F and Q ``(d, d)`` of a step from the attitude ``turn (3, 3)``.

    The blocks stand right behind the pose, in the order of a preintegrated step and its biases.
    """
    transition, noise = np.eye(layout.size), np.zeros((layout.size, layout.size))
    own = slice(0, IMU_NAV)
    transition[own, own], noise[own, own] = step.linear(turn)
    return transition, noise
