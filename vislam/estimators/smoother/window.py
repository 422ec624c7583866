"""iSAM2 of a window: variables leave it for good, and their marginal takes their place.

A marginal is a quadratic at the linearisation point at which its factors were eliminated, and cannot be
relinearised. Variables that it ties keep that point for as long as they are held, in all their other factors,
too: the first-estimates rule, without which the two would have different unobservable directions (Huang,
Mourikis and Roumeliotis, IEEE IROS 2011).

As long as what has left and what it is tied to keep their linearisation points, it is the same whether it is
eliminated at once or later: the marginal of the rest is. So from the step on with which it leaves, a variable
is not given any more and keeps its point, and its factors stay in the tree until those of some more steps are
eliminated with them. In between a step touches what is newest; if each eliminated what leaves with it, the
marginal would tie the oldest variables again with each step, and all from there to the newest would be
eliminated again.
"""

from collections.abc import Collection, Sequence

import gtsam

from vislam.estimators.smoother.marginal import collected
from vislam.estimators.smoother.numbered import NumberedTree
from vislam.estimators.smoother.values import only

_EVERY = 20
"""Updates between two eliminations of what has left."""


class Window(NumberedTree):
    """iSAM2 whose variables leave.

    GTSAM's slots are given again, so that there are no more of them than the window has factors. The tree has
    what has left and is not eliminated yet.

    Parameters
    ----------
    parameters : gtsam.ISAM2Params

    Attributes
    ----------
    fixed : set of int
        Variables that keep their linearisation point: what a marginal ties, and what has left.
    """

    def __init__(self, parameters: gtsam.ISAM2Params) -> None:
        parameters.findUnusedFactorSlots = True
        super().__init__(parameters)
        self.fixed: set[int] = set()
        # Marginals that the next update will bring, and slots that it will empty.
        self._new_marginals: list[int] = []
        self._emptied: list[int] = []
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
        """Update the tree; of factors that have gone into a marginal, or will, nothing is removed."""
        taken = [number for number in remove if number in self._slots and not self._leaves(number)]
        numbers = super().update(graph, values, parameters, taken)
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
        for number in self.touching(leaving):
            self.fixed.update(self.factors[number].keys())
        if self._updates % _EVERY == 0:
            self.eliminate()

    def eliminate(self) -> None:
        """Put marginals in the place of what has left; the tree gets them with the next update."""
        if not self._left:
            return
        inside, found = self.touching(self._left), self.marginal(self._left)
        # All of them are in the tree: no factor is given to what has left.
        self._emptied += [self._slots[number] for number in inside]
        for number, factor in found.items():
            self._note(number, factor)
        self._new_marginals += found
        for number in inside:
            self._forget(number)
        self._left = set()

    def held(self, values: gtsam.Values) -> gtsam.Values:
        """Those of some values that are of variables which have not left."""
        return only(values, self._of.keys() - self._left)

    def _solve(
        self,
        numbers: Sequence[int],
        graph: gtsam.NonlinearFactorGraph,
        values: gtsam.Values,
        parameters: gtsam.ISAM2UpdateParams,
    ) -> None:
        all_factors = collected(self.factors[number] for number in self._new_marginals)
        all_factors.push_back(graph)
        parameters.removeFactorIndices = self._emptied + parameters.removeFactorIndices
        super()._solve([*self._new_marginals, *numbers], all_factors, values, parameters)
        self._new_marginals, self._emptied = [], []

    def _leaves(self, number: int) -> bool:
        return not self._left.isdisjoint(self.factors[number].keys())
