"""iSAM2 of a window: variables leave it for good, and their marginal takes their place.

A marginal is a quadratic at the linearisation point at which its factors were eliminated, and cannot be
relinearised. Variables that it ties keep that point for as long as they are held, in all their other factors,
too: the first-estimates rule, without which the two would have different unobservable directions (Huang,
Mourikis and Roumeliotis, IEEE IROS 2011).

As long as what has left and what it is tied to keep their linearisation points, it is the same whether it is
eliminated at once or later: the marginal of the rest is. So from the step on with which it leaves, a variable
is not given any more and keeps its point, and its factors stay in the tree until those of some more steps are
eliminated with them. In between a step touches what is newest; if each eliminated what leaves with it, the
marginal would tie the oldest variables anew with each step, and all from there to the newest would be
eliminated again.
"""

from collections.abc import Collection, Sequence

import gtsam

from vislam.estimators.smoother.marginal import collected, marginal
from vislam.estimators.smoother.values import only

_EVERY = 20
"""Updates between two eliminations of what has left."""


class Window:
    """iSAM2 whose factors have numbers, which are not given again, and whose variables leave.

    GTSAM's slots are given again, so that there are no more of them than the window has factors.

    Parameters
    ----------
    parameters : gtsam.ISAM2Params

    Attributes
    ----------
    tree : gtsam.ISAM2
        With what has left and is not eliminated yet.
    size : int
        The next number of a factor that is given.
    fixed : set of int
        Variables that keep their linearisation point: what a marginal ties, and what has left.
    """

    def __init__(self, parameters: gtsam.ISAM2Params) -> None:
        parameters.findUnusedFactorSlots = True
        self.tree = gtsam.ISAM2(parameters)
        self.size = 0
        self.fixed: set[int] = set()
        self._factors: dict[int, gtsam.NonlinearFactor] = {}
        # Slot in the tree by number, but for marginals that the next update will bring.
        self._slots: dict[int, int] = {}
        self._new_marginals: list[int] = []
        # Slots that it will empty.
        self._emptied: list[int] = []
        self._marginals = 0
        # Numbers of the factors of each variable.
        self._of: dict[int, set[int]] = {}
        # What has left and is not eliminated.
        self._left: set[int] = set()
        self._updates = 0

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
            Their numbers; of factors that have gone into a marginal, or will, nothing is removed.
        """
        taken = [number for number in remove if number in self._slots and not self._leaves(number)]
        parameters.removeFactorIndices = self._emptied + [self._slots[number] for number in taken]
        for number in taken:
            self._forget(number)
        all_factors = collected(self._factors[number] for number in self._new_marginals)
        all_factors.push_back(graph)
        numbers = list(range(self.size, self.size + graph.size()))
        self.size += graph.size()
        for place, number in enumerate(numbers):
            self._note(number, graph.at(place))
        result = self.tree.update(all_factors, values, parameters)
        placed = zip(self._new_marginals + numbers, result.getNewFactorsIndices(), strict=True)
        self._slots.update(placed)
        self._new_marginals, self._emptied = [], []
        self.fixed.intersection_update(self._of)
        self._updates += 1
        return numbers

    def leave(self, keys: Collection[int]) -> None:
        """Let variables leave, at the linearisation point of the last update.

        Parameters
        ----------
        keys : collection of int
            Some may have lost all their factors before, and are not held any more.
        """
        leaving = self._of.keys() & keys
        self._left |= leaving
        for number in self._touching(leaving):
            self.fixed.update(self._factors[number].keys())
        if self._updates % _EVERY == 0:
            self._eliminate()

    def factors(self) -> dict[int, gtsam.NonlinearFactor]:
        """All factors by number, with the marginals of all that has left; those of marginals are negative."""
        self._eliminate()
        return dict(sorted(self._factors.items()))

    def held(self, values: gtsam.Values) -> gtsam.Values:
        """Those of some values that are of variables which have not left."""
        return only(values, self._of.keys() - self._left)

    def _eliminate(self) -> None:
        """Put marginals in the place of what has left; the tree gets them with the next update."""
        inside = sorted(self._touching(self._left))
        if not inside:
            return
        graph = collected(self._factors[number] for number in inside)
        # All of them are in the tree: no factor is given to what has left.
        self._emptied += [self._slots[number] for number in inside]
        for factor in marginal(graph, self.tree.getLinearizationPoint(), self._left):
            self._marginals += 1
            self._note(-self._marginals, factor)
            self._new_marginals.append(-self._marginals)
        for number in inside:
            self._forget(number)
        self._left = set()

    def _touching(self, keys: Collection[int]) -> set[int]:
        """Numbers of all factors of some variables."""
        return set().union(*(self._of[key] for key in keys))

    def _leaves(self, number: int) -> bool:
        return not self._left.isdisjoint(self._factors[number].keys())

    def _note(self, number: int, factor: gtsam.NonlinearFactor) -> None:
        self._factors[number] = factor
        for key in list(factor.keys()):
            self._of.setdefault(key, set()).add(number)

    def _forget(self, number: int) -> None:
        """Forget a factor, and the variables that have no other."""
        del self._slots[number]
        for key in list(self._factors.pop(number).keys()):
            self._of[key].discard(number)
            if not self._of[key]:
                del self._of[key]
