"""Score of the noise levels: derivative of the likelihood of all innovations, from one backward pass.

With r and N the adjoint of the data that came later (:mod:`vislam.estimators.ekf.linear`), noise of
covariance ``g g^T`` that enters the error at a time changes the log likelihood L with its variance q by

    dL / d log q = 1/2 ((g^T r)^2 - g^T N g),

and the white noise of a measurement by ``1/2 R (u^2 - D)``, where ``u = S^-1 innovation - K^T r`` and
``D = S^-1 + K^T N K`` are the smoothing error and its covariance. It is Fisher's identity, the expectation of
the score of noise that were seen, given all data (Segal and Weinstein, *A new method for evaluating the
log-likelihood gradient, the Hessian, and the Fisher information matrix for linear dynamic systems*, IEEE
Trans. Inf. Theory 35 (1989) 682-687; Koopman and Shephard, *Exact score for time series models in state
space form*, Biometrika 79 (1992) 823-826). So all levels cost one run of the filter and its backward pass,
however many they are. A number that was recorded of the motion enters by the mean: by what it changes the
state, ``dL = r . dx``, or an innovation, ``dL = -u . d(innovation)``; a clock follows by the chain rule. All
is exact for the linear steps that the filter has taken: where these were linearised is held.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, IntArray
from vislam.core.estimator import Problem
from vislam.estimators.ekf.linear import Adjoint, Correction, Step

WHITE, DRIFT, TWIST, ACCELERATION, HEIGHT = "white", "drift", "twist", "acceleration", "height"
_PLACES = {
    WHITE: slice(0, 1),
    DRIFT: slice(1, 2),
    TWIST: slice(2, 8),
    ACCELERATION: slice(8, 14),
    HEIGHT: slice(14, 15),
}
LEVELS = 15
"""How many levels there are."""
INPUTS = 7
"""Numbers recorded of the motion over a step: the mean twist (6), and the vertical velocity."""
OF_TWIST, OF_VERTICAL_VELOCITY = slice(0, 6), slice(6, 7)


@dataclass(frozen=True)
class Scores:
    """Derivatives of the log likelihood, by the frame at which noise or a recorded number enters.

    Attributes
    ----------
    levels : (T, LEVELS)
        By the logarithm of each level.
    inputs : (T, INPUTS)
        By the mean twist and the vertical velocity of the step to a frame [s/rad, s/m].
    """

    levels: Array
    inputs: Array

    @classmethod
    def none(cls, frames: int) -> "Scores":
        """Zeros."""
        return cls(np.zeros((frames, LEVELS)), np.zeros((frames, INPUTS)))


def levels(problem: Problem) -> Array:
    """Levels ``(LEVELS,)`` of a problem that scores are taken of; 0 where one is not in use.

    White noise and drift of the pixels [px], densities of the twist (6), of the acceleration (6) and of the
    integrated vertical velocity, in the units of the problem.
    """
    out = np.zeros(LEVELS)
    out[_PLACES[WHITE]], out[_PLACES[DRIFT]] = problem.track_noise.white, problem.track_noise.drift
    if problem.imu is None:
        out[_PLACES[TWIST]] = problem.noise.twist
        if problem.noise.acceleration is not None:
            out[_PLACES[ACCELERATION]] = problem.noise.acceleration
        if problem.vertical_velocity is not None:
            out[_PLACES[HEIGHT]] = problem.vertical_velocity.walk
    return out


@dataclass(frozen=True)
class StateNoise(Step):
    """White noise that enters the error at a frame.

    Attributes
    ----------
    k : int
    level : str
        One noise has a column for each number of the level, or one column after the other for each of these.
    first : int
        Row of the error at which that of its first block begins.
    by : (n, s, m)
        What a standard deviation of each does to a block of s rows; the blocks are contiguous where ``slots``
        is None, and each has noise of its own.
    slots : (n,) or None
        Which blocks these are.
    """

    k: int
    level: str
    first: int
    by: Array
    slots: IntArray | None = None

    def add_to(self, scores: Scores, after: Adjoint) -> None:
        """Add the score of the logarithm of its levels."""
        n, size, _ = self.by.shape
        slots = np.arange(n) if self.slots is None else self.slots
        rows = self.first + size * slots[:, None] + np.arange(size)
        vector = after.vectors[rows, 0]
        information = after.information[rows[:, :, None], rows[:, None, :]]
        told = np.einsum("nsm,ns->nm", self.by, vector) ** 2
        lost = np.sum(self.by * (information @ self.by), axis=1)
        place = _PLACES[self.level]
        scores.levels[self.k, place] += (told - lost).reshape(-1, place.stop - place.start).sum(axis=0)


@dataclass(frozen=True)
class MeasurementNoise(Step):
    """White noise of some rows of the measurement that follows.

    Attributes
    ----------
    k : int
    level : str
    rows : slice
    variance : (m,)
        A row for each number of the level, or one after the other for each of these.
    """

    k: int
    level: str
    rows: slice
    variance: Array

    def add_to(self, scores: Scores, error: Array, spread: Array) -> None:
        """Add the score from smoothing error and variance, ``(m,)`` each; of a twist, that by it as well."""
        found = self.variance * (error[self.rows] ** 2 - spread[self.rows])
        place = _PLACES[self.level]
        scores.levels[self.k, place] += found.reshape(-1, place.stop - place.start).sum(axis=0)
        if self.level == TWIST:
            scores.inputs[self.k, OF_TWIST] -= error[self.rows]


@dataclass(frozen=True)
class Input(Step):
    """Recorded numbers that change the state at a frame.

    Attributes
    ----------
    k : int
    place : slice
        Which of the inputs these m are.
    first : int
        Row of the error at which what they change begins.
    by : (s, m)
        By what s rows change with them.
    """

    k: int
    place: slice
    first: int
    by: Array

    def add_to(self, scores: Scores, after: Adjoint) -> None:
        """Add the derivative."""
        scores.inputs[self.k, self.place] += (
            after.vectors[self.first : self.first + len(self.by), 0] @ self.by
        )


def score(steps: Iterable[Step], *, size: int, frames: int) -> Scores:
    """Derivatives of the log likelihood.

    Parameters
    ----------
    steps : iterable of Step
        All steps of a filter with the noise that entered, the last first.
    size : int
        Of the error in the end.
    frames : int
    """
    scores, adjoint = Scores.none(frames), Adjoint.of_the_last(size)
    error, spread = np.empty(0), np.empty(0)
    for step in steps:
        if isinstance(step, StateNoise | Input):
            step.add_to(scores, adjoint)
        elif isinstance(step, MeasurementNoise):
            step.add_to(scores, error, spread)
        elif isinstance(step, Correction):
            smoothing = step.smoothing_error(adjoint)
            error, spread = smoothing.value, np.diagonal(smoothing.cov).copy()
            adjoint = step.back_by(smoothing, adjoint)
        else:
            adjoint = step.back(adjoint)
    return scores
