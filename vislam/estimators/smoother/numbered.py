"""iSAM2 of a part of a graph, whose factors have numbers that stay when the tree is another one."""

from collections.abc import Collection, Mapping, Sequence

import gtsam

from vislam.estimators.smoother.marginal import collected, marginal


class NumberedTree:
    """iSAM2 whose factors have numbers; those that are given from 0 on, those of marginals below.

    No number is given twice, as a slot of GTSAM's may be.

    Parameters
    ----------
    parameters : gtsam.ISAM2Params

    Attributes
    ----------
    tree : gtsam.ISAM2
    factors : dict of int to gtsam.NonlinearFactor
        By number.
    size : int
        The next number of a factor that is given.
    """

    def __init__(self, parameters: gtsam.ISAM2Params) -> None:
        self._parameters = parameters
        self.tree = gtsam.ISAM2(parameters)
        self.factors: dict[int, gtsam.NonlinearFactor] = {}
        self.size = 0
        self._marginals = 0
        # Slot in the tree by number, and numbers of the factors of each variable.
        self._slots: dict[int, int] = {}
        self._of: dict[int, set[int]] = {}

    def update(
        self,
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        parameters: gtsam.ISAM2UpdateParams,
        remove: Sequence[int] = (),
    ) -> list[int]:
        """Update the tree; returns the numbers of the new factors.

        Parameters
        ----------
        graph, values
            New factors, and first values of new variables.
        parameters : gtsam.ISAM2UpdateParams
            All but the factors to remove.
        remove : sequence of int
            Their numbers.
        """
        parameters.removeFactorIndices = [self._slots[number] for number in remove]
        for number in remove:
            self._forget(number)
        numbers = list(range(self.size, self.size + graph.size()))
        self.size += graph.size()
        for place, number in enumerate(numbers):
            self._note(number, graph.at(place))
        self._solve(numbers, graph, values, parameters)
        return numbers

    def solved(
        self, factors: Mapping[int, gtsam.NonlinearFactor], values: gtsam.Values, last: gtsam.KeyGroupMap
    ) -> "NumberedTree":
        """Another tree that takes the place of this one, of factors with the numbers that they have.

        Parameters
        ----------
        factors : mapping of int to gtsam.NonlinearFactor
        values : gtsam.Values
            Where they are linearised.
        last : gtsam.KeyGroupMap
            What is eliminated last.
        """
        found, parameters = NumberedTree(self._parameters), gtsam.ISAM2UpdateParams()
        found.size, found._marginals = self.size, self._marginals
        parameters.constrainedKeys = last
        for number, factor in factors.items():
            found._note(number, factor)
        found._solve(list(factors), collected(factors.values()), values, parameters)
        return found

    def touching(self, keys: Collection[int]) -> set[int]:
        """Numbers of all factors of some variables."""
        return set().union(*(self._of[key] for key in keys))

    def marginal(self, leaving: Collection[int]) -> dict[int, gtsam.NonlinearFactor]:
        """Marginal of all factors of what leaves on the rest, by new numbers; nothing changes by it."""
        inside = self.touching(leaving)
        # In the order in which the tree was given them.
        graph = collected(factor for number, factor in self.factors.items() if number in inside)
        found = marginal(graph, self.tree.getLinearizationPoint(), leaving)
        first, self._marginals = self._marginals + 1, self._marginals + len(found)
        return {-number: factor for number, factor in enumerate(found, start=first)}

    def _solve(
        self,
        numbers: Sequence[int],
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        parameters: gtsam.ISAM2UpdateParams,
    ) -> None:
        result = self.tree.update(graph, values, parameters)
        self._slots.update(zip(numbers, result.getNewFactorsIndices(), strict=True))

    def _note(self, number: int, factor: gtsam.NonlinearFactor) -> None:
        self.factors[number] = factor
        for key in list(factor.keys()):
            self._of.setdefault(key, set()).add(number)

    def _forget(self, number: int) -> None:
        """Forget a factor, and the variables that have no other."""
        del self._slots[number]
        for key in list(self.factors.pop(number).keys()):
            self._of[key].discard(number)
            if not self._of[key]:
                del self._of[key]
