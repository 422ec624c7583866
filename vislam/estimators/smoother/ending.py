"""The end of iSAM2: everything relinearised and solved, by Gauss-Newton on our own normal equations.

GTSAM's way to it is an update of the tree of the whole graph that relinearises all variables: the step of
Gauss-Newton, with an ordering and a tree that take longer than in proportion to the frames. Ours needs
neither, nor that what has left the tree comes back. What has left, as the rest, is solved at the point at
which it was linearised; a step of Gauss-Newton from there, whatever it does to the cost, is that solution,
the estimate that the iterations begin with.

GTSAM's it remains where pixels have shared errors, whose factors are its own, and where the fronts would be
wide: landmarks seen again that tie frames of all times.
"""

from dataclasses import dataclass

import gtsam
import numpy as np

from vislam.estimators.smoother.batch import Drive
from vislam.estimators.smoother.descent import Budget
from vislam.estimators.smoother.engine import WholeGraph
from vislam.estimators.smoother.objective import Objective
from vislam.estimators.smoother.options import SmootherOptions
from vislam.estimators.smoother.schur_descent import Iteration, gauss_newton, iterate
from vislam.estimators.smoother.tree import IndeterminateError

_WIDEST = 3000
"""Columns of a front beyond which the end is GTSAM's. To eliminate one of these takes a tenth of a second,
and a drive has one to four frames."""


@dataclass(frozen=True)
class Ended:
    """An estimate that everything was relinearised for.

    Attributes
    ----------
    values : gtsam.Values
    undone : bool
        Whether an iteration could not be solved, and was the last.
    stopped : str
        Option whose budget ended it before; empty if none did.
    """

    values: gtsam.Values
    undone: bool
    stopped: str


def relinearised(engine: WholeGraph, drive: Drive, options: SmootherOptions, budget: Budget) -> Ended:
    """Relinearise everything and solve it, as often as the options ask for."""
    if options.relinearize_every > 0 and drive.frames and not drive.stereo.repeated:
        found = _start(engine, drive)
        if found is not None:
            return _iterated(*found, options, budget)
    return _updated(engine, options, budget)


def _start(engine: WholeGraph, drive: Drive) -> tuple[Objective, Iteration] | None:
    """The estimate that the iterations begin with; None where they are GTSAM's affair."""
    values = engine.newest() if engine.whole else engine.linearization_point()
    objective = drive.objective(values)
    if objective.width > _WIDEST:
        return None
    estimate = objective.estimate(values)
    if not engine.whole:
        try:
            estimate = gauss_newton(objective, estimate)
        except np.linalg.LinAlgError:
            estimate = objective.estimate(engine.estimate())
    cost = objective.cost(estimate)
    return (objective, Iteration(estimate, cost, 0.0)) if np.isfinite(cost) else None


def _iterated(objective: Objective, at: Iteration, options: SmootherOptions, budget: Budget) -> Ended:
    """Gauss-Newton, with Levenberg's damping where the cost would rise."""
    for _ in range(options.final_iterations):
        if budget.spent:
            return Ended(objective.values(at.estimate), undone=False, stopped=budget.spent)
        before, at = at, iterate(objective, at)
        budget.count("relinearised", cost=at.cost, fall=before.cost - at.cost)
        if at.estimate is before.estimate:
            return Ended(objective.values(at.estimate), undone=at.stuck, stopped="")
    return Ended(objective.values(at.estimate), undone=False, stopped="")


def _updated(engine: WholeGraph, options: SmootherOptions, budget: Budget) -> Ended:
    """Updates of the tree of the whole graph."""
    values = engine.estimate()
    for _ in range(options.final_iterations):
        if budget.spent:
            return Ended(values, undone=False, stopped=budget.spent)
        try:
            engine.converge()
            values = engine.estimate()
        except IndeterminateError:
            return Ended(values, undone=True, stopped="")
        budget.count("relinearised")
    return Ended(values, undone=False, stopped="")
