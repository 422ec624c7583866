"""The likelihood of a recording as a function of what is searched."""

from collections.abc import Sequence as Items
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.calibration.likelihood import Evaluator, Stretch
from vislam.calibration.parameters import Parameter, at
from vislam.comparison.config import Config


@dataclass(frozen=True)
class Point:
    """A point ``(p,)``, the log likelihood of all frames there, and its score ``(T, p)`` by frame."""

    value: Array
    log_likelihood: float
    scores: Array

    @property
    def gradient(self) -> Array:
        """Score ``(p,)`` of all frames."""
        return np.asarray(self.scores.sum(axis=0))


@dataclass(frozen=True)
class Target:
    """Log likelihood of all frames.

    Attributes
    ----------
    begin : Config
        That parameters are written into.
    chosen : list of Parameter
    evaluator : Evaluator
    usable : (n,)
        Observations that are fused.
    stretches : sequence of Stretch
        All frames, in parts that scores are taken of side by side.
    """

    begin: Config
    chosen: list[Parameter]
    evaluator: Evaluator
    usable: BoolArray
    stretches: Items[Stretch] = ()

    def config(self, point: Array) -> Config:
        """Config of a point."""
        return at(self.begin, self.chosen, point)

    def evaluate(self, points: list[Array]) -> list[Array]:
        """Log likelihood ``(T,)`` of each frame at each point."""
        return self.evaluator.log_likelihoods([self.config(point) for point in points], usable=self.usable)

    def scored(self, value: Array) -> Point:
        """Log likelihood and score at a point.

        The score of levels and of what moves the recorded motion is by the backward pass, that of all else by
        differences.
        """
        levels, inputs, others = self.by_level(value), self.by_input(value), self.others(value)
        rows = np.concatenate([np.arange(one.begin, one.end) for one in self.stretches])
        moved = [self.config(there) for index in others for there in self._beside(value, index)]
        found, values = self.evaluator.scored(
            self.config(value), moved, usable=self.usable, stretches=self.stretches
        )
        scores = found.scores.levels @ levels
        scores += np.einsum("ti,tip->tp", found.scores.inputs, inputs[rows])
        for index, above, below in zip(others, values[::2], values[1::2], strict=True):
            slope = (above - below) / (2.0 * self.chosen[index].step)
            scores[:, index] = np.nan_to_num(slope, posinf=0.0, neginf=0.0)
        return Point(value, float(found.log_likelihood.sum()), scores)

    def others(self, value: Array) -> list[int]:
        """Parameters that move neither levels of noise nor the recorded motion."""
        moves = self.by_level(value).any(axis=0) | self.by_input(value).any(axis=(0, 1))
        return np.flatnonzero(~moves).tolist()

    def by_level(self, value: Array) -> Array:
        """Derivative ``(LEVELS, p)`` of the logarithms of the noise levels by the parameters."""
        columns = []
        for index, item in enumerate(self.chosen):
            above, below = (self.evaluator.levels(self.config(there)) for there in self._beside(value, index))
            used = (above > 0.0) & (below > 0.0)
            ratio = np.divide(above, below, out=np.ones(len(used)), where=used)
            columns.append(np.log(ratio) / (2.0 * item.step))
        return np.column_stack(columns)

    def by_input(self, value: Array) -> Array:
        """Derivative ``(T, INPUTS, p)`` of the recorded motion at all frames."""
        found = []
        for index, item in enumerate(self.chosen):
            above, below = (self.evaluator.inputs(self.config(there)) for there in self._beside(value, index))
            found.append((above - below) / (2.0 * item.step))
        return np.stack(found, axis=-1)

    def _beside(self, value: Array, index: int) -> tuple[Array, Array]:
        """Points above and below, a step of a parameter away."""
        step = np.zeros(len(value))
        step[index] = self.chosen[index].step
        return value + step, value - step
