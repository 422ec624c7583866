"""Levenberg-Marquardt step by step, within a budget that all descents of an optimisation share."""

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import gtsam
import numpy as np

Tell = Callable[[str], None]
Solver = Literal["cholesky", "qr"]
_log = logging.getLogger("vislam.estimators.smoother")
CONVERGED = 1e-8
"""An iteration that lowers the cost by less than this share of it is the last of its descent."""
NOTHING = 1e-5
"""So is one that lowers it by less than this, as in GTSAM's own loop."""
MOST_ITERATIONS = 50
"""Iterations of one descent, at most."""


class Budget:
    """Iterations and wall time that an optimisation may take, over all its rounds and descents.

    Parameters
    ----------
    iterations : int
        At most.
    seconds : float or None
        From now on [s]; None: no bound.
    tell : callable
        Is given a line after each iteration.

    Attributes
    ----------
    done : int
        Iterations done.
    fall : float
        What the last of them took off the cost.
    """

    def __init__(self, iterations: int, seconds: float | None = None, *, tell: Tell = _log.info) -> None:
        self._iterations, self._seconds, self._tell = iterations, seconds, tell
        self._began = time.monotonic()
        self.done, self.fall = 0, 0.0

    @property
    def spent(self) -> str:
        """Option that forbids another iteration; empty while none does."""
        if self.done >= self._iterations:
            return "max_iterations"
        late = self._seconds is not None and time.monotonic() - self._began >= self._seconds
        return "budget_s" if late else ""

    def count(self, what: str, *, cost: float | None = None, fall: float = 0.0) -> None:
        """Count an iteration of something, and report it."""
        self.done, self.fall = self.done + 1, fall
        level = "" if cost is None else f", cost {cost:.6g}"
        self._tell(f"{what}: iteration {self.done} of at most {self._iterations}{level}")


@dataclass(frozen=True)
class Descent:
    """Where a descent ended.

    Attributes
    ----------
    values : gtsam.Values
    cost : float
        Half the sum of the squared whitened residuals, under the robust kernel.
    damped : bool
        Whether steps were rejected, so that the damping ended above where it began.
    cut : bool
        Whether the budget ended it.
    """

    values: gtsam.Values
    cost: float
    damped: bool
    cut: bool


def descend(
    graph: gtsam.NonlinearFactorGraph,
    start: gtsam.Values,
    *,
    solver: Solver,
    budget: Budget,
    most: int = MOST_ITERATIONS,
) -> Descent:
    """Levenberg-Marquardt until it converges, for ``most`` iterations, or until the budget is spent.

    GTSAM's own ``optimize`` does the same with no way to stop it: signals wait until it returns.
    """
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setLinearSolverType(f"MULTIFRONTAL_{solver.upper()}")
    # A step that changes the cost by less than this share ends the search for its damping, too.
    parameters.setRelativeErrorTol(CONVERGED)
    optimizer = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters)
    cost, cut = optimizer.error(), False
    for _ in range(most):
        if not 0.0 < cost < np.inf or (cut := bool(budget.spent)):
            break
        optimizer.iterate()
        before, cost = cost, optimizer.error()
        fall = before - cost
        budget.count(f"optimisation ({solver})", cost=cost, fall=fall)
        if fall <= max(CONVERGED * before, NOTHING):
            break
    damped = optimizer.lambda_() > parameters.getlambdaInitial()
    return Descent(optimizer.values(), cost, damped, cut)
