"""Levenberg-Marquardt on our own normal equations, with the landmarks eliminated by their Schur complement.

Damping, acceptance and convergence are those of GTSAM's optimiser with its default parameters, so that both
take the same steps: ``(H + lambda I) d = b`` with lambda divided by ten after a step that takes enough of
what it foresees off the cost, and multiplied by ten otherwise. An iteration linearises once; a step that is
rejected costs another factorisation and no linearisation.
"""

from contextlib import suppress
from dataclasses import dataclass

import gtsam
import numpy as np

from vislam.estimators.smoother.descent import CONVERGED, MOST_ITERATIONS, NOTHING, Budget, Descent
from vislam.estimators.smoother.objective import Estimate, Objective

_FIRST, _MOST, _BY = 1e-5, 1e5, 10.0
"""Damping of the first iteration, the largest, and the factor by which it changes."""
_ENOUGH = 1e-3
"""Share of what the linearised cost is to fall by that the cost has to fall by."""


@dataclass(frozen=True)
class Iteration:
    """Result of an iteration.

    Attributes
    ----------
    estimate : Estimate
    cost : float
    damping : float
        For the next iteration.
    """

    estimate: Estimate
    cost: float
    damping: float

    @property
    def stuck(self) -> bool:
        """Whether no damping lowered the cost, nor left it as it was."""
        return self.damping >= _MOST


def descend(
    objective: Objective, start: gtsam.Values, *, budget: Budget, most: int = MOST_ITERATIONS
) -> Descent:
    """Levenberg-Marquardt until it converges, for ``most`` iterations, or until the budget is spent."""
    at, cut = first_step(objective, start), False
    for _ in range(most):
        if not 0.0 < at.cost < np.inf or (cut := bool(budget.spent)):
            break
        before, at = at.cost, iterate(objective, at)
        fall = before - at.cost
        budget.count("optimisation (schur)", cost=at.cost, fall=fall)
        if fall <= max(CONVERGED * before, NOTHING):
            break
    return Descent(objective.values(at.estimate), at.cost, at.damping > _FIRST, cut)


def first_step(objective: Objective, start: gtsam.Values) -> Iteration:
    """Where the first iteration begins."""
    estimate = objective.estimate(start)
    return Iteration(estimate, objective.cost(estimate), _FIRST)


def gauss_newton(objective: Objective, estimate: Estimate) -> Estimate:
    """Estimate after one Gauss-Newton step, whatever it does to the cost.

    Raises
    ------
    numpy.linalg.LinAlgError
        If the normal equations are not positive definite.
    """
    return objective.moved(estimate, *objective.equations(estimate).factorised().step())


def iterate(objective: Objective, at: Iteration) -> Iteration:
    """One iteration, from where the last one ended; the same estimate where no damping lowers the cost."""
    equations, damping = objective.equations(at.estimate), at.damping
    while True:
        with suppress(np.linalg.LinAlgError):
            step = equations.factorised(damping).step()
            moved = objective.moved(at.estimate, *step)
            cost, foreseen = objective.cost(moved), equations.fall(*step, damping)
            if foreseen > 0.0 and at.cost - cost > _ENOUGH * foreseen:
                return Iteration(moved, cost, damping / _BY)
            if abs(at.cost - cost) < CONVERGED * at.cost:
                return Iteration(at.estimate, at.cost, damping)
        damping = max(_BY * damping, _FIRST)
        if damping >= _MOST:
            return Iteration(at.estimate, at.cost, damping)
