"""Marginals of a graph on the variables that stay, where others are eliminated and leave."""

from collections.abc import Collection, Iterable

import gtsam


def marginal(
    graph: gtsam.NonlinearFactorGraph, point: gtsam.Values, leaving: Collection[int]
) -> list[gtsam.LinearContainerFactor]:
    """Marginal of a graph, linearised at a point, on what does not leave.

    By QR: what is left of the information on the way from the first pose is little beside that of the last
    step, and normal equations would lose its digits.

    Parameters
    ----------
    graph : gtsam.NonlinearFactorGraph
        All factors of the variables that leave.
    point : gtsam.Values
        Where they are linearised. The marginal's factors keep it, of their own variables.
    leaving : collection of int
        Variables that leave.

    Raises
    ------
    RuntimeError
        If the factors do not determine what leaves, given what stays.
    """
    linear = graph.linearize(point)
    _, rest = linear.eliminatePartialMultifrontal(sorted(leaving), gtsam.EliminateQR)
    factors = [rest.at(index) for index in range(rest.size()) if rest.exists(index)]
    return [gtsam.LinearContainerFactor(factor, point) for factor in factors if factor.keys()]


def collected(factors: Iterable[gtsam.NonlinearFactor]) -> gtsam.NonlinearFactorGraph:
    """Graph of some factors."""
    found = gtsam.NonlinearFactorGraph()
    for factor in factors:
        found.push_back(factor)
    return found
