"""Shared errors that enter the recorded twist as variables: clock, direction of the velocity, rotation psi.

GTSAM's stereo factor has a fixed mounting. A rotation of the cameras is a rotation of the body instead: with

    G_k = exp(-psi_0) T_k exp(psi_k)

in place of the body's pose T_k as the variable, the cameras are mounted as stated, and the motion of a step
is

    G_{k-1}^-1 G_k = exp(-psi_{k-1}) (T_{k-1}^-1 T_k) exp(psi_k),

so that the twist of the step is the body's turned by ``exp(-psi)``, and what psi walks by is a further
rotation at its end. With u the recorded twist less the prior's mean of its bias, ``u'`` its slope by the
clock c, a the direction of the velocity, and the bias ``beta`` along the axes of the cameras, the variable of
a step is

    w_k = R(psi)^T (u + c u' - u_x E a) + J_r^-1 (psi_k - psi_{k-1}) / dt - beta,

a function of the shared errors and of what is recorded alone, and linear but for terms of second order in the
errors, which hardly change from step to step. So it is taken as linear where they were read last. White noise
of the twist and walk of its bias, too, are taken along the axes of the cameras, which is the same where they
are alike about all axes, and some thousandths off elsewhere.

In the world of G the first pose is the identity, as in that of T: the worlds are those of the first camera
and of the first body. Where the vertical is estimated, the world is the vertical's for both, and ``G_k = T_k
exp(psi_k)`` (:mod:`vislam.estimators.smoother.world`).
"""

from collections.abc import Mapping

import gtsam
import numpy as np

from vislam.base.types import Array
from vislam.core.frame import Frame
from vislam.estimators.smoother.keys import C, D, Y
from vislam.geometry import se3, so3
from vislam.models import SharedPrior, odometry
from vislam.models.shared_errors import CAMERA_ROTATION, CLOCK, SIZES, VELOCITY_DIRECTION

_LETTERS = {CLOCK: C, VELOCITY_DIRECTION: D, CAMERA_ROTATION: Y}


class TwistErrors:
    """Variables of these errors, and their values as read last.

    Clock and direction are those of a step and begin with the first one; the rotation is that of a frame.

    Parameters
    ----------
    priors : mapping of str to SharedPrior
        Those of the shared errors that are not known.

    Attributes
    ----------
    values : dict of str to (m,)
        By name.
    """

    def __init__(self, priors: Mapping[str, SharedPrior]) -> None:
        self._priors = {name: priors[name] for name in _LETTERS if name in priors}
        self.values = {name: np.zeros(SIZES[name]) for name in self._priors}

    @property
    def turned(self) -> bool:
        """Whether the cameras may be turned against the body."""
        return CAMERA_ROTATION in self._priors

    def rotation(self, k: int) -> int:
        """Key of the rotation at a frame."""
        return self._key(CAMERA_ROTATION, k)

    def keys(self, k: int) -> list[int]:
        """Keys of those that are new at a frame: what walks, and what is constant where it begins."""
        return [self._of_frame(name, k) for name in self._priors if self._new(name, k)]

    def tied(self, k: int) -> list[int]:
        """Keys that the factors of the next frame tie to, or by which poses are reported."""
        found = [self._of_frame(name, k) for name in self._priors if self._begun(name, k)]
        if self.turned and self._walks(CAMERA_ROTATION):
            found += [self.rotation(max(k - 1, 0)), self.rotation(0)]
        return list(dict.fromkeys(found))

    def last(self, k: int) -> dict[str, int]:
        """Keys of the newest variables at a frame, by name."""
        return {name: self._of_frame(name, k) for name in self._priors if self._begun(name, k)}

    def walked(self, name: str, frame: Frame) -> float:
        """Variance of what an error has walked by since its newest variable: that of a step is behind it."""
        return 0.0 if self._first(name) == 0 else frame.dt * self._priors[name].walk ** 2

    def insert(self, values: gtsam.Values, k: int) -> None:
        """Insert the variables that are new at a frame, as known so far."""
        for name, value in self.values.items():
            if self._new(name, k):
                values.insert(self._of_frame(name, k), value)

    def factors(self, frame: Frame, before: Frame | None) -> list[gtsam.NonlinearFactor]:
        """Priors where they begin, and walks."""
        found: list[gtsam.NonlinearFactor] = []
        for name, prior in self._priors.items():
            if not self._new(name, frame.k):
                continue
            key, size = self._of_frame(name, frame.k), SIZES[name]
            if frame.k == self._first(name):
                sigma = _sigmas(np.full(size, prior.sigma))
                found.append(gtsam.PriorFactorVector(key, np.zeros(size), sigma))
                continue
            assert before is not None
            # Clock and direction are those of a step: they walk while the step before lasts.
            dt = frame.dt if self._first(name) == 0 else before.dt
            sigma = _sigmas(np.full(size, np.sqrt(dt) * prior.walk))
            earlier = self._of_frame(name, frame.k - 1)
            found.append(gtsam.BetweenFactorVector(earlier, key, np.zeros(size), sigma))
        return found

    def recorded(self, frame: Frame, mean: Array) -> tuple[Array, dict[str, Array]]:
        """Twist of a step as recorded, with the errors as read last, and its derivatives by them.

        Parameters
        ----------
        frame : Frame
        mean : (6,)
            What is taken off it first.

        Returns
        -------
        twist : (6,)
            Along the axes of the cameras' body, the walk of their rotation left out.
        by : dict of str to (6, m)
            By name.
        """
        step, by = frame.odometry, {}
        twist = step.twist - mean
        if CLOCK in self._priors:
            # At the first frame there is no step, and no change over it.
            by[CLOCK] = step.twist_change[:, None] / frame.dt if frame.k else np.zeros((6, 1))
        if VELOCITY_DIRECTION in self._priors:
            by[VELOCITY_DIRECTION] = -step.twist[3] * odometry.ACROSS
        twist = twist + sum(matrix @ self.values[name] for name, matrix in by.items())
        if self.turned:
            psi = self.values[CAMERA_ROTATION]
            back = np.kron(np.eye(2), so3.exp(-psi))
            twist, by = back @ twist, {name: back @ matrix for name, matrix in by.items()}
            turns = np.concatenate([so3.hat(twist[:3]), so3.hat(twist[3:])])
            by[CAMERA_ROTATION] = turns @ so3.left_jacobian(-psi)
        return twist, by

    def terms(self, frame: Frame, mean: Array, bias: Array) -> tuple[Array, dict[int, Array]]:
        """The variable of a step and its bias as linear functions: ``w + beta = c + sum_i A_i theta_i``.

        Parameters
        ----------
        frame : Frame
        mean : (6,)
            What is taken off the recorded twist.
        bias : (6,)
            beta as known, with which the motion of the step is predicted.

        Returns
        -------
        constant : (6,)
            c.
        terms : dict of int to (6, m)
            A by the keys of the errors.
        """
        twist, by = self.recorded(frame, mean)
        constant = twist - sum(matrix @ self.values[name] for name, matrix in by.items())
        # The rotation is that of the frame before the step, as are the clock and the direction.
        found = {self._key(name, frame.k - 1): matrix for name, matrix in by.items()}
        if self.turned and self._walks(CAMERA_ROTATION):
            psi = self.values[CAMERA_ROTATION]
            at_end = np.linalg.inv(se3.right_jacobian(frame.dt * (twist - bias)))[:, :3] / frame.dt
            walked = at_end @ so3.left_jacobian(-psi)
            found[self.rotation(frame.k - 1)] = found[self.rotation(frame.k - 1)] - walked
            found[self.rotation(frame.k)] = walked
        return np.asarray(constant), found

    def turn_back(self, twist: Array) -> Array:
        """Twist ``(6,)`` along the axes of the body."""
        if not self.turned:
            return twist
        return np.asarray(np.kron(np.eye(2), so3.exp(self.values[CAMERA_ROTATION])) @ twist)

    def _walks(self, name: str) -> bool:
        return self._priors[name].walk > 0.0

    def _key(self, name: str, index: int) -> int:
        key: int = _LETTERS[name](index if self._walks(name) else 0)
        return key

    def _first(self, name: str) -> int:
        """First frame that has a variable."""
        return 0 if name == CAMERA_ROTATION else 1

    def _begun(self, name: str, k: int) -> bool:
        return k >= self._first(name)

    def _of_frame(self, name: str, k: int) -> int:
        """Key of the newest variable at a frame."""
        return self._key(name, k - self._first(name))

    def _new(self, name: str, k: int) -> bool:
        """Whether a frame has a variable that the one before did not have."""
        return k == self._first(name) or (self._walks(name) and self._begun(name, k))


def _sigmas(sigma: Array) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Diagonal.Sigmas(sigma)
