"""The likelihood of a recording as a function of what is searched."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from vislam.base.types import Array, BoolArray
from vislam.calibration.likelihood import Evaluator
from vislam.calibration.parameters import Parameter, at, largest_of, lowest_of, point_of
from vislam.calibration.search import ROUNDS, Bounds, Local, Maximum, Round, Secants, maximise, with_curvature
from vislam.comparison.config import Config

TOLERANCE = 0.5
"""Log likelihood that is worth another round, and that a level must be worth."""


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
    """

    begin: Config
    chosen: list[Parameter]
    evaluator: Evaluator
    usable: BoolArray

    def config(self, point: Array) -> Config:
        """Config of a point."""
        return at(self.begin, self.chosen, point)

    def evaluate(self, points: list[Array]) -> list[float]:
        """Log likelihood at each point; minus infinity where the filter fails."""
        configs = [self.config(point) for point in points]
        return [float(one.sum()) for one in self.evaluator.log_likelihoods(configs, usable=self.usable)]

    def differentiate(self, point: Array) -> Local:
        """Log likelihood, scores and information at a point, by a step of each parameter."""
        steps = np.array([item.step for item in self.chosen])
        beside = [self.config(moved) for moved in point + np.diag(steps)]
        found = self.evaluator.beside(self.config(point), beside, usable=self.usable)
        if not all(np.isfinite(one).all() for one in (found.log_likelihood, found.moved)):
            none = np.zeros((len(found.log_likelihood), len(point)))
            return Local(point, -np.inf, none, np.eye(len(point)))
        # The step's own curvature is taken out of the difference.
        information = found.information / np.outer(steps, steps)
        bend = 0.5 * steps * np.diagonal(information) / len(found.log_likelihood)
        scores = (found.moved - found.log_likelihood[:, None]) / steps + bend
        return Local(point, float(found.log_likelihood.sum()), scores, information)

    def with_curvature(self, maximum: Maximum) -> Maximum:
        """Maximum whose intervals are by the curvature of the likelihood, a run for each parameter."""
        return with_curvature(maximum, self.evaluate, np.array([item.span for item in self.chosen]))

    def maximum(
        self,
        *,
        most: int = ROUNDS,
        secants: Secants | None = None,
        on_round: Callable[[Round], None] = lambda ended: None,
    ) -> Maximum:
        """Maximum from where it begins (:func:`vislam.calibration.search.maximise`)."""
        return maximise(
            self.differentiate,
            self.evaluate,
            point_of(self.begin, self.chosen),
            bounds=Bounds(lowest_of(self.chosen), largest_of(self.chosen)),
            tolerance=TOLERANCE,
            most=most,
            secants=secants,
            on_round=on_round,
        )
